"""Numbers that surgeons plan with: a table of left, right and their difference."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mammometry.measure.shape.anthropometry import Dimensions

_SIDES = ("left", "right")
_NOT_MEASURED = "not measured"
_COVERAGE_95 = 1.96  # standard deviations of a normal distribution on either side that hold 95 %


@dataclass(frozen=True, slots=True, kw_only=True)
class Length:
    """One number with half the width of its 95 % interval, mm."""

    value_mm: float
    half_mm: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthRow:
    """A row of the table of lengths."""

    title: str
    sides: tuple[Length | None, Length | None]
    """Left and right. None: not measured."""
    missing: tuple[str, str] = ("", "")
    """Why a side has no number; empty where it has one."""

    @property
    def cells(self) -> tuple[tuple[str, Length | None, str], ...]:
        """Side, number, and why there is none: left, then right."""
        return tuple(zip(_SIDES, self.sides, self.missing, strict=True))

    @property
    def difference(self) -> Length | None:
        """Left less right. None without both."""
        left, right = self.sides
        if left is None or right is None:
            return None
        known = left.half_mm is not None and right.half_mm is not None
        half = math.hypot(left.half_mm, right.half_mm) if known else None  # type: ignore[arg-type]
        return Length(value_mm=left.value_mm - right.value_mm, half_mm=half)


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthTable:
    """All rows in the order in which a breast is examined, and what has no side."""

    rows: tuple[LengthRow, ...]
    nipples: Length | None
    """From nipple to nipple. None: not measured."""

    @property
    def has_gaps(self) -> bool:
        """Whether a landmark lacks for one of its numbers."""
        return any(why.startswith(_NOT_MEASURED) for row in self.rows for why in row.missing)


_ROWS = (
    ("Sternal notch to nipple", ("sn_n_straight",), "mark the nipple and the sternal notch"),
    ("Nipple to fold, along the skin", ("n_imf_along_skin",), "mark the nipple and the fold"),
    ("Nipple to midline", ("n_midline_straight",), "mark the nipple"),
    ("Base width", ("base_width_straight", "base_width"), "mark its inner and outer end"),
    ("Projection", ("projection",), "draw the boundary"),
    ("Nipple below the fold (ptosis)", ("nipple_below_fold",), "mark the nipple"),
)
"""Title, codes of `hospital.exported.Quantity` (the first that is there), what to do where it lacks."""
_NIPPLE = ("n_midline_straight", "nipple_below_fold")
"""Codes that are there where a nipple is marked."""
_WITH_NIPPLE = {"sn_n_straight": "mark the sternal notch", "n_imf_along_skin": "mark the fold"}


def length_table(quantities: Sequence[Mapping[str, Any]]) -> LengthTable | None:
    """Lay out a measurement's quantities. None: none is a torso's length.

    Args:
        quantities: rows with the names of `hospital.exported.Quantity`: of `quantities_of`, or as a clinic keeps them.
    """
    by_code = {(str(row["code"]), str(row.get("side") or "")): row for row in quantities}
    breasts = [side for side in _SIDES if ("projection", side) in by_code]
    if not breasts:
        return None
    rows = []
    for title, codes, remedy in _ROWS:
        lengths, missing = [], []
        for side in _SIDES:
            row = next((by_code[code, side] for code in codes if (code, side) in by_code), None)
            lengths.append(None if row is None else _length(row))
            nipple = any((code, side) in by_code for code in _NIPPLE)
            what = _WITH_NIPPLE.get(codes[0], remedy) if nipple else remedy
            missing.append("" if row is not None else f"{_NOT_MEASURED}: {what}" if side in breasts else "no breast")
        rows.append(LengthRow(title=title, sides=(lengths[0], lengths[1]), missing=(missing[0], missing[1])))
    between = by_code.get(("n_n_straight", ""))
    return LengthTable(rows=tuple(rows), nipples=None if between is None else _length(between))


def quantities_of(dimensions: Dimensions) -> Iterator[dict[str, Any]]:
    """Sizes beside the volumes, with the names and values of `hospital.exported.Quantity`."""
    for length in dimensions.lengths:
        name, side = _sided(length.name)
        ways = (
            ("straight", "straight", length.straight_mm, length.straight_sigma_mm),
            ("along_skin", "along the skin", length.geodesic_mm, length.geodesic_sigma_mm),
        )
        for way, words, value, sigma in ways:
            if value is not None:
                code = f"{name.lower().replace('-', '_').replace(' ', '_')}_{way}"
                title = f"{_without_side(length.title, side)}, {words}"
                yield _quantity(code, title, side, value, sigma, method=way.replace("_", "-"))
    for shape in dimensions.shapes:
        for code, title, value in (
            ("base_width", "Base width", shape.base_width_mm),
            ("base_height", "Base height", shape.base_height_mm),
        ):
            yield _quantity(code, title, shape.name, value, shape.base_sigma_mm, method="extent")
        for code, title, volume in (
            ("upper_pole", "Volume above the nipple's level", shape.above_nipple_cc),
            ("lower_pole", "Volume below the nipple's level", shape.below_nipple_cc),
        ):
            if volume is not None:
                yield _quantity(code, title, shape.name, volume, shape.pole_sigma_cc, method="level-cut", unit="cm3")
    for sunk in dimensions.ptosis:
        title, value = "Nipple below the fold", sunk.nipple_below_fold_mm
        yield _quantity("nipple_below_fold", title, sunk.name, value, sunk.sigma_mm, method="height")


def projections_of(dimensions: Dimensions) -> Iterator[dict[str, Any]]:
    """How far each breast stands out, for the table. Exports have it beside the volume, with its boundary."""
    for shape in dimensions.shapes:
        value, sigma = shape.projection_mm, shape.projection_sigma_mm
        yield _quantity("projection", "Projection", shape.name, value, sigma, method="plane-distance")


def length_words(value: Length | None, sign: str = "") -> str:
    """A length in mm with its interval: "212.3 ± 4.1", a difference with its sign: "+4.2 ± 5.8".

    A line may end before ±, not after it.
    """
    if value is None:
        return "–"
    half = "" if value.half_mm is None else f" ±\u00a0{value.half_mm:.1f}"
    return f"{value.value_mm:{sign}.1f}{half}".replace("-", "−")


def _sided(name: str) -> tuple[str, str]:
    """A length's name without its side, and the side. Empty: it has none."""
    first, _, last = name.rpartition(" ")
    return (first, last) if last in _SIDES else (name, "")


def _without_side(title: str, side: str) -> str:
    """A length's title for both sides: "nipple to fold"."""
    return title.replace(f"{side} ", "").replace(f", {side}", "") if side else title


def _quantity(
    code: str, title: str, side: str, value: float, sigma: float | None, *, method: str, unit: str = "mm"
) -> dict[str, Any]:
    about = {"title": title, "unit": unit, "method": method}
    return {"code": code, "side": side, "value": value, "sigma": sigma, **about}


def _length(row: Mapping[str, Any]) -> Length:
    value, interval, sigma = float(row["value"]), row.get("interval_95"), row.get("sigma")
    half = (interval[1] - interval[0]) / 2 if interval else _COVERAGE_95 * sigma if sigma is not None else None
    return Length(value_mm=value, half_mm=half)
