"""A study for REDCap: data dictionary and records.

Records are numbered by their photographs and stand in the order of their numbers, so that importing the same again
changes nothing. The dictionary does not depend on what was measured, so that it never loses a field.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import get_args

from mammometry.base.csv_cells import csv_text
from mammometry.base.errors import TableError
from mammometry.hospital.exported import Exported, Quantity
from mammometry.hospital.tables import confirmation, rounded, visit_number
from mammometry.measure.volume.definitions import Meaning

DICTIONARY, RECORDS = "data-dictionary.csv", "records.csv"
FILES = (DICTIONARY, RECORDS)
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


def tables(sessions: Sequence[Exported]) -> dict[str, bytes]:
    """Name of a file → its content. The same sessions give the same bytes, in whatever order.

    Raises:
        TableError: two sessions of the same photographs.
    """
    return {DICTIONARY: dictionary().encode(), RECORDS: records(sessions).encode()}


def dictionary() -> str:
    """All fields of a record, as REDCap reads them."""
    rows = []
    for name, (label, kind) in _VISIT.items():
        rows.append(_field(name, label, kind))
    for name, (label, unit) in _numbers().items():
        rows.append(_field(name, label, "number", note=unit))
    rows += [_field(name, label, "") for name, label in _WHYS.items()]
    return csv_text(_HEADER, rows)


def records(sessions: Sequence[Exported]) -> str:
    """One row a visit.

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
        ]
    return csv_text((*_VISIT, *numbers, *_WHYS), (rows[number] for number in sorted(rows)))


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
        for code, unit in (*ways, ("upper_pole", "cm3"), ("lower_pole", "cm3"), ("nipple_below_fold", "mm")):
            fields[f"{code}_{side}"] = (f"{side.capitalize()} {code.replace('_', ' ')}", unit)
            fields[f"{code}_{side}_sd"] = (f"{side.capitalize()} {code.replace('_', ' ')}, standard uncertainty", unit)
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
