"""Measurements as a table with a codebook.

CSV, and Parquet where pyarrow is installed. One row a number.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

from mammometry.base.csv_cells import csv_text
from mammometry.hospital.codes import METHODS, NO_VOLUMES
from mammometry.hospital.exported import Exported

TABLE, PARQUET, CODEBOOK = "measurements.csv", "measurements.parquet", "codebook.csv"
FILES = (TABLE, PARQUET, CODEBOOK)
Cell = str | float | None
_COLUMNS = {
    "visit": ("text", "", "Stable number of the visit: equal for results of the same photographs"),
    "subject": ("text", "", "Pseudonym of the subject, else the name of the session's folder"),
    "taken": ("date", "", "Day of the photographs, ISO 8601. Empty: not given"),
    "kind": ("text", "", "torso: a patient; model: a cast; surface: an open surface"),
    "side": ("text", "", "The patient's left or right breast, model, or empty for both sides"),
    "code": ("text", "", "What was measured; see the rows below"),
    "title": ("text", "", "The same in words"),
    "value": ("number", "as unit says", "The measured value. Empty where there is none; see why"),
    "unit": ("text", "", "cm3, cm2 or mm (UCUM)"),
    "low_95": ("number", "as unit says", "Lower limit of the 95 % interval. Empty: not known"),
    "high_95": ("number", "as unit says", "Upper limit of the 95 % interval. Empty: not known"),
    "standard_uncertainty": ("number", "as unit says", "Standard uncertainty. Empty: not known, or see the interval"),
    "method": ("text", "", "How it was measured; see the rows below"),
    "wall": ("text", "", "Wall behind the breast. Empty for what has none"),
    "why": ("text", "", "Why there is no volume: none, unclear or refused"),
    "confirmed": ("text", "", "yes: a person looked at the measured boundaries and found them right; no: nobody yet"),
    "confirmed_on": ("date", "", "Day of that, ISO 8601. Empty: not confirmed, or de-identified"),
    "software": ("text", "", "Version of mammometry"),
}
"""Column → type, unit, meaning."""
_NUMBERS = [name for name, (kind, _, _) in _COLUMNS.items() if kind == "number"]
_DECIMALS = 4  # of written figures: finer than any uncertainty here


def tables(sessions: Sequence[Exported]) -> dict[str, bytes]:
    """Name of a file → its content. The same sessions give the same bytes, in whatever order."""
    rows = sorted(
        (row for session in sessions for row in _rows(session)), key=lambda row: [str(cell or "") for cell in row]
    )
    files = {TABLE: csv_text(_COLUMNS, rows).encode(), CODEBOOK: codebook(sessions).encode()}
    parquet = _parquet(rows)
    return files if parquet is None else {**files, PARQUET: parquet}


def codebook(sessions: Sequence[Exported]) -> str:
    """What columns and codes mean."""
    titles = {quantity.code: (quantity.title, quantity.unit) for session in sessions for quantity in session.quantities}
    rows = [("column", name, kind, unit, meaning) for name, (kind, unit, meaning) in _COLUMNS.items()]
    rows += [("code", code, "number", unit, title) for code, (title, unit) in sorted(titles.items())]
    rows += [("method", code, "text", "", meaning) for code, meaning in METHODS.items()]
    rows += [("why", code, "text", "", meaning) for code, meaning in NO_VOLUMES.items()]
    return csv_text(("of", "name", "type", "unit", "meaning"), rows)


def visit_number(exported: Exported) -> str:
    """Stable number of a visit, from its photographs."""
    return exported.source[:12]


def rounded(value: float | None) -> float | None:
    """A number as tables give it."""
    return None if value is None else round(value, _DECIMALS)


def confirmation(exported: Exported) -> tuple[str, str]:
    """Whether and when somebody confirmed the boundaries. Tables do not say who."""
    confirmed = exported.clinical.confirmed
    return ("no", "") if confirmed is None else ("yes", confirmed.at.date().isoformat())


def _rows(exported: Exported) -> list[tuple[Cell, ...]]:
    taken = "" if exported.taken is None else exported.taken.isoformat()
    end = (*confirmation(exported), exported.software)
    begin = (visit_number(exported), exported.subject, taken, exported.kind)
    rows: list[tuple[Cell, ...]] = []
    for quantity in exported.quantities:
        low, high = quantity.interval_95 or (None, None)
        error = (rounded(low), rounded(high), rounded(quantity.sigma))
        cells = (quantity.side, quantity.code, quantity.title, rounded(quantity.value), quantity.unit)
        rows.append((*begin, *cells, *error, quantity.method, quantity.wall, "", *end))
    for side in exported.absent:
        nothing = (side.side, "volume", "Volume", None, "cm3", None, None, None)
        rows.append((*begin, *nothing, "", "", side.kind, *end))
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
