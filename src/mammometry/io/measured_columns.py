"""Method and unit in the name of a column of measurements."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import TableError
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.csv_tables import CsvTable


@dataclass(frozen=True, slots=True, kw_only=True)
class _Unit:
    """A unit at the end of a column's name."""

    kind: str
    """Quantity that is measured."""
    factor: float
    """Factor to the base unit of its kind."""
    shown: str
    """Spelling in the report."""
    most: float = np.inf
    """Largest value for a breast or trunk. Above it, the unit is something else: ``water_l`` may be the left side."""


_LENGTH, _AREA, _VOLUME, _MASS = "length", "area", "volume", "mass"
_UNITS = {
    "mm": _Unit(kind=_LENGTH, factor=1.0, shown="mm"),
    "cm": _Unit(kind=_LENGTH, factor=10.0, shown="cm"),
    "m": _Unit(kind=_LENGTH, factor=1000.0, shown="m", most=3.0),
    "in": _Unit(kind=_LENGTH, factor=25.4, shown="in"),
    "mm2": _Unit(kind=_AREA, factor=0.01, shown="mm2"),
    "cm2": _Unit(kind=_AREA, factor=1.0, shown="cm2"),
    "mm3": _Unit(kind=_VOLUME, factor=0.001, shown="mm3"),
    "cc": _Unit(kind=_VOLUME, factor=1.0, shown="cc"),
    "ml": _Unit(kind=_VOLUME, factor=1.0, shown="ml"),
    "dl": _Unit(kind=_VOLUME, factor=100.0, shown="dl"),
    "l": _Unit(kind=_VOLUME, factor=1000.0, shown="l", most=20.0),
    "g": _Unit(kind=_MASS, factor=1.0, shown="g"),
    "kg": _Unit(kind=_MASS, factor=1000.0, shown="kg"),
}
_OTHER_WORDS = {"cm3": "cc", "ccm": "cc", "inch": "in", "inches": "in", "sqcm": "cm2", "gram": "g", "grams": "g",
                "litre": "l", "liter": "l", "litres": "l", "liters": "l"}  # fmt: skip
_ENDING = re.compile(r"(?P<name>.+?)(?:[\s_.,/-]+(?P<bare>[^\W_]+)|[\s_]*[(\[]\s*(?P<bracket>[^)\]]+?)\s*[)\]])\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredColumn:
    """A column of measurements."""

    name: str
    """Name in the table."""
    title: str
    """Name without the unit, for reports."""
    unit: str
    """Unit in reports. Empty: the name does not contain a known unit."""


def same_unit(reference: str, measured: str) -> bool:
    """Whether the names of two columns end with the same unit, or one of them has no unit."""
    units = [_unit_of(name)[1] for name in (reference, measured)]
    return units[0] is units[1] or None in units


def measured_column(name: str, values: Float64[Array, " n"]) -> MeasuredColumn:
    """Split a column's name into title and unit: ``water_cc``, ``tape (cm)``, ``3D [mL]``.

    Args:
        name: name of the column.
        values: its numbers. They distinguish litres from the left side, and metres from other words.
    """
    title, unit = _unit_of(name)
    if unit is None or float(np.median(np.abs(values))) > unit.most:
        return MeasuredColumn(name=name, title=name.replace("_", " "), unit="")
    return MeasuredColumn(name=name, title=title.replace("_", " "), unit=unit.shown)


def _unit_of(name: str) -> tuple[str, _Unit | None]:
    """Title and unit of a column's name."""
    match = _ENDING.fullmatch(name)
    if match is None:
        return name, None
    word = (match["bare"] or match["bracket"]).casefold().replace("²", "2").replace("³", "3").replace("^", "")
    return match["name"], _UNITS.get(_OTHER_WORDS.get(word, word))


def common_unit(
    table: CsvTable, reference: MeasuredColumn, measured: MeasuredColumn
) -> tuple[str, Float64[Array, " 2"]]:
    """Common unit of two columns, and the factors to it. A column without a unit has that of the other.

    Raises:
        TableError: the units are of different kinds, such as cm and cc.
    """
    if not reference.unit or not measured.unit:
        return reference.unit or measured.unit, np.ones(2)
    units = [_UNITS[column.unit] for column in (reference, measured)]
    if units[0].kind != units[1].kind:
        raise TableError(
            table.name,
            found=f"a {units[0].kind} in column {reference.name} but a {units[1].kind} in column {measured.name}",
            expected="two columns of one quantity",
            remedy="Choose other columns, or correct the units in their names",
        )
    smaller = min(units, key=lambda unit: unit.factor)
    return smaller.shown, np.array([unit.factor / smaller.factor for unit in units])
