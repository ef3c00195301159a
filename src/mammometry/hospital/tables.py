"""Measurements as a table with a codebook, plain or for REDCap."""

import io
from collections.abc import Iterator, Sequence
from typing import get_args

from mammometry.base.csv_cells import csv_text
from mammometry.base.errors import TableError
from mammometry.hospital.codes import DEFINITIONS, METHODS, NO_VOLUMES
from mammometry.hospital.exported import Exported, Quantity
from mammometry.measure.volume.measurement import Meaning

TABLE, PARQUET, CODEBOOK = "measurements.csv", "measurements.parquet", "codebook.csv"
FILES = (TABLE, PARQUET, CODEBOOK)
Cell = str | float | None
_COLUMNS = {
    "visit": ("text", "", "Stable number of the visit: equal for results of the same photographs"),
    "subject": ("text", "", "Pseudonym of the subject, or the name of the session's folder"),
    "taken": ("date", "", "Day of the photographs, ISO 8601. Empty: not given"),
    "kind": ("text", "", "torso: a patient; model: a cast; surface: an open surface"),
    "side": ("text", "", "The patient's left or right breast, model, or empty for both sides"),
    "code": ("text", "", "Measured quantity; see the rows below"),
    "title": ("text", "", "The same as text"),
    "value": ("number", "as unit says", "The measured value. Empty if there is none; see why"),
    "unit": ("text", "", "cm3, cm2 or mm (UCUM)"),
    "low_95": ("number", "as unit says", "Lower limit of the 95 % interval. Empty: not known"),
    "high_95": ("number", "as unit says", "Upper limit of the 95 % interval. Empty: not known"),
    "standard_uncertainty": ("number", "as unit says", "Standard uncertainty. Empty: not known, or see the interval"),
    "method": ("text", "", "Method; see the rows below"),
    "wall": ("text", "", "Wall behind the breast. Empty if there is none"),
    "why": ("text", "", "Why there is no volume: none, unclear or refused"),
    "confirmed": ("text", "", "yes: a person checked the measured boundaries and found them right; no: not yet"),
    "confirmed_on": ("date", "", "Day of that, ISO 8601. Empty: not confirmed, or de-identified"),
    "software": ("text", "", "Version of mammometry"),
    "posture": ("text", "", "The patient's posture. Empty: not entered"),
    "apart": ("text", "", "Why the breast's volumes are not comparable with most of the study. Empty: they are"),
}
"""Column → type, unit, meaning."""
_NUMBERS = [name for name, (kind, _, _) in _COLUMNS.items() if kind == "number"]
_DECIMALS = 4  # of written figures: finer than any uncertainty here


def tables(sessions: Sequence[Exported]) -> dict[str, bytes]:
    """Name of a file → its content. The same sessions give the same bytes, in any order."""
    rows = sorted(
        (row for session in sessions for row in _rows(session)), key=lambda row: [str(cell or "") for cell in row]
    )
    files = {TABLE: csv_text(_COLUMNS, rows).encode(), CODEBOOK: codebook(sessions).encode()}
    parquet = _parquet(rows)
    return files if parquet is None else {**files, PARQUET: parquet}


def codebook(sessions: Sequence[Exported]) -> str:
    """Codebook: the meanings of columns and codes."""
    titles = {quantity.code: (quantity.title, quantity.unit) for session in sessions for quantity in session.quantities}
    rows = [("column", name, kind, unit, meaning) for name, (kind, unit, meaning) in _COLUMNS.items()]
    rows += [
        ("code", code, "number", unit, f"{title}. {DEFINITIONS[code]}" if code in DEFINITIONS else title)
        for code, (title, unit) in sorted(titles.items())
    ]
    rows += [("method", code, "text", "", meaning) for code, meaning in METHODS.items()]
    rows += [("why", code, "text", "", meaning) for code, meaning in NO_VOLUMES.items()]
    return csv_text(("of", "name", "type", "unit", "meaning"), rows)


def visit_number(exported: Exported) -> str:
    """Stable number of a visit, from its photographs."""
    return exported.source[:12]


def rounded(value: float | None) -> float | None:
    """A number in a table's notation."""
    return None if value is None else round(value, _DECIMALS)


def confirmation(exported: Exported) -> tuple[str, str]:
    """State and time of the boundaries' confirmation, without the person."""
    confirmed = exported.clinical.confirmed
    return ("no", "") if confirmed is None else ("yes", confirmed.at.date().isoformat())


def _rows(exported: Exported) -> list[tuple[Cell, ...]]:
    taken = "" if exported.taken is None else exported.taken.isoformat()
    end = (*confirmation(exported), exported.software, exported.clinical.posture)
    begin = (visit_number(exported), exported.subject, taken, exported.kind)
    rows: list[tuple[Cell, ...]] = []
    for quantity in exported.quantities:
        low, high = quantity.interval_95 or (None, None)
        error = (rounded(low), rounded(high), rounded(quantity.sigma))
        cells = (quantity.side, quantity.code, quantity.title, rounded(quantity.value), quantity.unit)
        rows.append(
            (*begin, *cells, *error, quantity.method, quantity.wall, "", *end, exported.apart.get(quantity.side, ""))
        )
    for side in exported.absent:
        nothing = (side.side, "volume", "Volume", None, "cm3", None, None, None)
        rows.append((*begin, *nothing, "", "", side.kind, *end, ""))
    return rows


def _parquet(rows: Sequence[tuple[Cell, ...]]) -> bytes | None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        return None
    schema = pa.schema([(name, pa.float64() if name in _NUMBERS else pa.string()) for name in _COLUMNS])
    columns = {name: [row[place] for row in rows] for place, name in enumerate(_COLUMNS)}
    buffer = io.BytesIO()
    pq.write_table(pa.table(columns, schema=schema), buffer)
    return buffer.getvalue()


DICTIONARY, RECORDS = "data-dictionary.csv", "records.csv"
REDCAP_FILES = (DICTIONARY, RECORDS)
_FORM = "breast_volume"
_HEADER = (
    "Variable / Field Name",
    "Form Name",
    "Section Header",
    "Field Type",
    "Field Label",
    "Choices, Calculations, OR Slider Labels",
    "Field Note",
    "Text Validation Type OR Show Slider Number",
    "Text Validation Min",
    "Text Validation Max",
    "Identifier?",
    "Branching Logic (Show field only if...)",
    "Required Field?",
    "Custom Alignment",
    "Question Number (surveys only)",
    "Matrix Group Name",
    "Matrix Ranking?",
    "Field Annotation",
)
_VISIT = {
    "record_id": ("Visit, by its photographs", ""),
    "subject": ("Pseudonym of the subject", ""),
    "taken": ("Day of the photographs", "date_ymd"),
    "kind": ("torso, model or surface", ""),
    "confirmed": ("Whether a person confirmed the measured boundaries: yes or no", ""),
    "confirmed_on": ("Day of the confirmation", "date_ymd"),
    "software": ("Version of mammometry", ""),
}
_WHYS = {"why_left": "Why the left breast has no volume", "why_right": "Why the right breast has no volume"}
_APART = {
    f"apart_{side}": f"Why the {side} breast's volumes are not comparable with most of the study"
    for side in ("left", "right")
}


def redcap_tables(sessions: Sequence[Exported]) -> dict[str, bytes]:
    """Name of a file → its content. The same sessions give the same bytes, in any order.

    Raises:
        TableError: two sessions of the same photographs.
    """
    return {DICTIONARY: dictionary().encode(), RECORDS: records(sessions).encode()}


def dictionary() -> str:
    """All fields of a record for REDCap."""
    rows = []
    for name, (label, kind) in _VISIT.items():
        rows.append(_field(name, label, kind))
    for name, (label, unit) in _numbers().items():
        definition = DEFINITIONS.get(name.partition("_left")[0].partition("_right")[0], "")
        rows.append(_field(name, label, "number", note=f"{unit}. {definition}" if definition else unit))
    rows += [_field(name, label, "") for name, label in {**_WHYS, **_APART}.items()]
    return csv_text(_HEADER, rows)


def records(sessions: Sequence[Exported]) -> str:
    """Records for REDCap, one row per visit.

    Raises:
        TableError: two sessions of the same photographs.
    """
    numbers = _numbers()
    rows: dict[str, list[object]] = {}
    for session in sessions:
        number = visit_number(session)
        if number in rows:
            raise TableError(
                session.subject or number,
                found="two sessions of the same photographs",
                expected="each visit once",
                remedy="Leave one of them out",
            )
        measured = {name: value for quantity in session.quantities for name, value in _values(quantity)}
        whys = {f"why_{side.side}": side.kind for side in session.absent}
        taken = "" if session.taken is None else session.taken.isoformat()
        rows[number] = [
            *(number, session.subject, taken, session.kind, *confirmation(session), session.software),
            *(rounded(measured.get(name)) for name in numbers),
            *(whys.get(name) for name in _WHYS),
            *(session.apart.get(name.removeprefix("apart_"), "") for name in _APART),
        ]
    return csv_text((*_VISIT, *numbers, *_WHYS, *_APART), (rows[number] for number in sorted(rows)))


def _numbers() -> dict[str, tuple[str, str]]:
    """Field → label and unit, for every number that can be measured."""
    fields: dict[str, tuple[str, str]] = {}
    for side in ("left", "right", "model"):
        kinds = [("volume", "volume", "cm3")]
        if side != "model":
            kinds += [
                (f"volume_{meaning.replace(' ', '_')}", f"volume, {meaning}", "cm3") for meaning in get_args(Meaning)
            ]
        for code, title, unit in kinds:
            fields[f"{code}_{side}"] = (f"{side.capitalize()} {title}", unit)
            fields[f"{code}_{side}_low"] = (f"{side.capitalize()} {title}, lower limit of the 95 % interval", unit)
            fields[f"{code}_{side}_high"] = (f"{side.capitalize()} {title}, upper limit of the 95 % interval", unit)
        for code, unit in (("projection", "mm"), ("skin_area", "cm2"), ("base_area", "cm2")):
            fields[f"{code}_{side}"] = (f"{side.capitalize()} {code.replace('_', ' ')}", unit)
        lengths = ("sn_n", "n_imf", "base_width", "n_midline") if side != "model" else ()
        ways = [(f"{length}_{way}", "mm") for length in lengths for way in ("straight", "along_skin")]
        extents = (("boundary_width", "mm"), ("boundary_height", "mm"))
        for code, unit in (*ways, *extents, ("upper_pole", "cm3"), ("lower_pole", "cm3"), ("nipple_below_fold", "mm")):
            fields[f"{code}_{side}"] = (f"{side.capitalize()} {code.replace('_', ' ')}", unit)
            fields[f"{code}_{side}_sd"] = (f"{side.capitalize()} {code.replace('_', ' ')}, standard uncertainty", unit)
    apart = "Volume, left minus right"
    fields["volume_left_less_right"] = (apart, "cm3")
    fields["volume_left_less_right_low"] = (f"{apart}, lower limit of the 95 % interval", "cm3")
    fields["volume_left_less_right_high"] = (f"{apart}, upper limit of the 95 % interval", "cm3")
    for way in ("straight", "along_skin"):
        fields[f"n_n_{way}"] = (f"Nipple to nipple, {way.replace('_', ' ')}", "mm")
        fields[f"n_n_{way}_sd"] = (f"Nipple to nipple, {way.replace('_', ' ')}, standard uncertainty", "mm")
    return fields


def _values(quantity: Quantity) -> Iterator[tuple[str, float]]:
    yield quantity.name, quantity.value
    if quantity.interval_95 is not None:
        yield f"{quantity.name}_low", quantity.interval_95[0]
        yield f"{quantity.name}_high", quantity.interval_95[1]
    if quantity.sigma is not None:
        yield f"{quantity.name}_sd", quantity.sigma


def _field(name: str, label: str, kind: str, note: str = "") -> list[str]:
    row = [""] * len(_HEADER)
    row[0], row[1], row[3], row[4], row[6], row[7] = name, _FORM, "text", label, note, kind
    return row
