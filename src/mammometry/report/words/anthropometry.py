"""Lengths, shape and asymmetry as text, and the table of lengths for surgical planning."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mammometry.base.normal import COVERAGE_95
from mammometry.base.notices.words import NAMES
from mammometry.base.rounding import at_95, rounded_words
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.landmarks.landmarks import LANDMARKS, Landmark
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.shape.anthropometry import Dimensions
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.measure.volume.difference import difference
from mammometry.measure.volume.measurement import VolumeDeficit, VolumeMeasurement
from mammometry.report.content import Fact, LargeNumber, sentence
from mammometry.report.words.volumes import measured_words, span_words, verdict_words, volume_words
from mammometry.study.tables import TextTable, signed

_SIDES = ("left", "right")


@dataclass(frozen=True, slots=True, kw_only=True)
class Length:
    """A length and the half-width of its 95 % interval, mm."""

    value_mm: float
    half_mm: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthRow:
    """A row of the table of lengths."""

    title: str
    sides: tuple[Length | None, Length | None]
    """Left and right. None if not measured."""
    missing: tuple[str, str] = ("", "")
    """Reason why a side has no number. Empty if it has one."""

    @property
    def cells(self) -> tuple[tuple[str, Length | None, str], ...]:
        """Side, number, and reason for a missing number: left, then right."""
        return tuple(zip(_SIDES, self.sides, self.missing, strict=True))

    @property
    def difference(self) -> Length | None:
        """Left minus right. None unless both are known."""
        left, right = self.sides
        if left is None or right is None:
            return None
        known = left.half_mm is not None and right.half_mm is not None
        half = math.hypot(left.half_mm, right.half_mm) if known else None  # type: ignore[arg-type]
        return Length(value_mm=left.value_mm - right.value_mm, half_mm=half)


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthTable:
    """All rows in the order of an examination, and lengths that belong to no side."""

    rows: tuple[LengthRow, ...]
    nipples: Length | None
    """Distance between the nipples. None if not measured."""
    has_gaps: bool
    """Whether a length is missing because a landmark is not marked."""


_ROWS = (
    ("Sternal notch to nipple", ("sn_n_straight",), "mark the nipple and the sternal notch"),
    ("Nipple to fold, along the skin", ("n_imf_along_skin",), "mark the nipple and the fold"),
    ("Nipple to midline", ("n_midline_straight",), "mark the nipple"),
    ("Base width, straight", ("base_width_straight",), "mark its inner and outer end"),
    ("Boundary width", ("boundary_width", "base_width"), "draw the boundary"),
    ("Projection", ("projection",), "draw the boundary"),
    ("Nipple below the fold (ptosis)", ("nipple_below_fold",), "mark the nipple"),
)
"""Title, codes of `hospital.exported.Quantity`, and remedy if it is missing. The second code is the quantity's name in
rows stored by version 1.0."""
_NIPPLE = ("n_midline_straight", "nipple_below_fold")
"""Codes that need a marked nipple."""
_WITH_NIPPLE = {"sn_n_straight": "mark the sternal notch", "n_imf_along_skin": "mark the fold"}


def length_table(quantities: Sequence[Mapping[str, Any]]) -> LengthTable | None:
    """Arrange a measurement's quantities in a table. None if none of them is a length of a torso.

    Args:
        quantities: rows with the names of `hospital.exported.Quantity`, from `quantities_of` or as stored by a
            clinic.
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
            missing.append("" if row is not None else f"not measured: {what}" if side in breasts else "no breast")
        rows.append(LengthRow(title=title, sides=(lengths[0], lengths[1]), missing=(missing[0], missing[1])))
    between = by_code.get(("n_n_straight", ""))
    at = {side: number for number, side in enumerate(_SIDES)}
    has_gaps = any(row.sides[at[side]] is None for row in rows for side in breasts)
    return LengthTable(rows=tuple(rows), nipples=None if between is None else _length(between), has_gaps=has_gaps)


def quantities_of(dimensions: Dimensions) -> Iterator[dict[str, Any]]:
    """Quantities other than volumes, with the names and values of `hospital.exported.Quantity`."""
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
            ("boundary_width", "Boundary width", shape.base_width_mm),
            ("boundary_height", "Boundary height", shape.base_height_mm),
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
    """Projection of each breast for the table. Exports have it with the volume."""
    for shape in dimensions.shapes:
        value, sigma = shape.projection_mm, shape.projection_sigma_mm
        yield _quantity("projection", "Projection", shape.name, value, sigma, method="plane-distance")


def length_words(value: Length | None, *, sign: bool = False) -> str:
    """A length in mm with its interval, such as "212.3 ± 4.1", or a difference with its sign: "+4 ± 6".

    A line may break before ±, but not after it.
    """
    if value is None:
        return "–"
    return rounded_words(value.value_mm, value.half_mm, sign=sign).replace("± ", "±\u00a0")


def _sided(name: str) -> tuple[str, str]:
    """A length's name without its side, and the side, which is empty if there is none."""
    first, _, last = name.rpartition(" ")
    return (first, last) if last in _SIDES else (name, "")


def _without_side(title: str, side: str) -> str:
    """Title of a length for both sides, such as "nipple to fold"."""
    return title.replace(f"{side} ", "").replace(f", {side}", "") if side else title


def _quantity(
    code: str, title: str, side: str, value: float, sigma: float | None, *, method: str, unit: str = "mm"
) -> dict[str, Any]:
    about = {"title": title, "unit": unit, "method": method}
    return {"code": code, "side": side, "value": value, "sigma": sigma, **about}


def _length(row: Mapping[str, Any]) -> Length:
    value, interval, sigma = float(row["value"]), row.get("interval_95"), row.get("sigma")
    half = (interval[1] - interval[0]) / 2 if interval else COVERAGE_95 * sigma if sigma is not None else None
    return Length(value_mm=value, half_mm=half)


def comparison(
    measurements: Sequence[VolumeMeasurement], *, absent: Sequence[NoBreast] = (), lacking: Sequence[VolumeDeficit] = ()
) -> tuple[Fact, ...]:
    """Compare left and right: difference, ratio and deficit of the volumes, each with its interval."""
    sides = {measured.name: measured for measured in measurements}
    facts: tuple[Fact, ...] = ()
    if {"left", "right"} <= set(sides):
        facts = _both(sides["left"], sides["right"])
    elif len(sides) == 1 and absent and not absent[0].unclear and "model" not in sides:
        (only,) = sides.values()
        gap = signed(only.volume_cc if only.name == "left" else -only.volume_cc, 0)
        facts = (
            Fact(
                "Left minus right",
                f"{gap} cc: the {only.name} breast in front of its own chest wall. There is no breast on the "
                f"{absent[0].name} side. Its interval is that of the {only.name} breast",
            ),
        )
    return facts + tuple(_lacks(deficit) for deficit in lacking)


def difference_number(measurements: Sequence[VolumeMeasurement]) -> LargeNumber | None:
    """Difference of the two volumes for the first page. None unless there are two."""
    sides = {measured.name: measured for measured in measurements}
    if not {"left", "right"} <= set(sides):
        return None
    larger, smaller = sorted((sides["left"], sides["right"]), key=lambda side: side.volume_cc, reverse=True)
    change = difference(larger, smaller, "sides")
    note = f"{larger.name} larger"
    if change.beyond_error is not None:
        note += f", {verdict_words(change.beyond_error)}"
    return LargeNumber(
        title="Difference",
        value=volume_words(change.difference_cc, change.difference_interval_cc),
        interval=span_words(change.difference_interval_cc),
        note=note,
    )


def planning_lengths(dimensions: Dimensions | None, landmarks: Sequence[Landmark] = ()) -> tuple[TextTable | None, str]:
    """Surgical lengths with those that are missing, and a note about their landmarks.

    Args:
        dimensions: dimensions from the measurement. None: there are no lengths.
        landmarks: landmarks that were used.
    """
    if dimensions is None:
        return None, ""
    laid_out = length_table([*quantities_of(dimensions), *projections_of(dimensions)])
    if laid_out is None:
        return None, ""
    shown = [row for row in laid_out.rows if row.sides != (None, None)]
    rows = [(row.title, *map(length_words, row.sides), length_words(row.difference, sign=True)) for row in shown]
    grades = {ptosis.name: " or ".join(ptosis.likely) for ptosis in dimensions.ptosis}
    if grades:
        rows.append(("Ptosis, grade after Regnault", grades.get("left", "–"), grades.get("right", "–"), ""))
    table = TextTable(
        title="Lengths", columns=("Lengths in mm, ± 95 %", "Left", "Right", "Left minus right"), rows=tuple(rows)
    )
    lacking = [row.title[0].lower() + row.title[1:] for row in laid_out.rows if row.sides == (None, None)]
    note = [] if laid_out.nipples is None else [f"Nipple to nipple: {length_words(laid_out.nipples)} mm."]
    note += [f"Not measured, because a landmark is not marked: {'; '.join(lacking)}."] if lacking else []
    guessed = {mark.name for mark in landmarks if mark.proposed}
    titles = [mark.title for mark in LANDMARKS["torso"] if mark.name in guessed and mark.kind == "point"]
    note += [f"Proposed by the program, not confirmed: {', '.join(titles)}."] if titles else []
    return table, " ".join(note)


def _lacks(deficit: VolumeDeficit) -> Fact:
    """Text about the volume that a side lacks."""
    volume = measured_words(deficit.volume_cc, deficit.interval_cc)
    if deficit.volume_cc < 0:
        volume = f"nothing ({span_words(deficit.interval_cc)})"
    return Fact(f"Volume that the {deficit.name} side lacks", f"{volume}. {sentence(deficit.note)}")


def _both(left: VolumeMeasurement, right: VolumeMeasurement) -> tuple[Fact, ...]:
    larger, smaller = sorted((left, right), key=lambda side: side.volume_cc, reverse=True)
    change = difference(larger, smaller, "sides")
    interval_cc, share = change.difference_interval_cc, f"{100 / change.ratio:.0f} %"
    gap = f"{larger.name} larger by {measured_words(change.difference_cc, interval_cc)}"
    if interval_cc is not None:
        gap += f": {verdict_words(change.beyond_error)}. {change.note}"
    if change.ratio_interval is not None:
        low, high = (f"{100 / bound:.0f}" for bound in reversed(change.ratio_interval))
        share += f" (95 %: {low} to {high} %)"
    return (Fact("Difference in volume", gap), Fact(f"{smaller.name.capitalize()} as a share of {larger.name}", share))


def without_nipple(
    measurements: Sequence[VolumeMeasurement], landmarks: Sequence[Landmark], settings: MeasureSettings
) -> tuple[str, ...]:
    """Breasts of a torso whose nipple was not found reliably."""
    least = settings.nipple.least_probability
    seen = {mark.name for mark in landmarks if mark.probability >= least}
    names = [measured.name for measured in measurements if measured.name != "model"]
    return tuple(name for name in names if f"nipple_{name}" not in seen)


def symmetry_facts(symmetry: Symmetry | None) -> tuple[Fact, ...]:
    """Differences between the breasts in position and shape. Empty without a symmetry."""
    if symmetry is None:
        return ()
    across, up, ahead = symmetry.shift_mm
    return (
        Fact("Difference in shape (RMS)", f"{symmetry.rms_mm:.1f} mm, with one breast aligned to the other"),
        Fact("Difference in position and shape (RMS)", f"{symmetry.rms_mirrored_mm:.1f} mm"),
        Fact(
            "Movement from the mirrored right onto the left",
            f"{signed(across)} mm sideways, {signed(up)} mm up, {signed(ahead)} mm forwards, turned by "
            f"{symmetry.turn_deg:.0f}°",
        ),
        Fact("Asymmetry of the trunk (robust SD)", f"{symmetry.trunk_scatter_mm:.1f} mm from its mid-sagittal plane"),
    )


def dimension_tables(dimensions: Dimensions | None, landmarks: Sequence[Landmark] = ()) -> tuple[TextTable, ...]:
    """Tables of lengths, shape and ptosis, without empty ones."""
    if dimensions is None:
        return ()
    lengths = TextTable(
        title="Lengths, ± 95 %",
        columns=("from, to", "straight, mm", "along the skin, mm"),
        rows=tuple(
            (
                length.title,
                at_95(length.straight_mm, length.straight_sigma_mm),
                "–" if length.geodesic_mm is None else at_95(length.geodesic_mm, length.geodesic_sigma_mm),
            )
            for length in dimensions.lengths
        ),
    )
    shapes = TextTable(
        title="Shape, ± 95 %",
        columns=("breast", "boundary, width × height, mm", "projection, mm", "upper pole, cc", "lower pole, cc"),
        rows=tuple(
            (
                NAMES[shape.name],
                f"{shape.base_width_mm:.0f} × {shape.base_height_mm:.0f}",
                at_95(shape.projection_mm, shape.projection_sigma_mm),
                "–" if shape.above_nipple_cc is None else at_95(shape.above_nipple_cc, shape.pole_sigma_cc),
                "–" if shape.below_nipple_cc is None else at_95(shape.below_nipple_cc, shape.pole_sigma_cc),
            )
            for shape in dimensions.shapes
        ),
    )
    names = tuple(dict.fromkeys(name for shape in dimensions.shapes for name in shape.quadrants_cc))
    quadrants = TextTable(
        title="Volume of the quadrants around the nipple, cc",
        columns=("breast", *names),
        rows=tuple(
            (
                NAMES[shape.name],
                *(f"{shape.quadrants_cc[name]:.0f}" if name in shape.quadrants_cc else "–" for name in names),
            )
            for shape in dimensions.shapes
            if shape.quadrants_cc
        ),
    )
    sunk = TextTable(
        title="Ptosis (Regnault)",
        columns=("breast", "grade", "grades within 95 %", "nipple below the fold, mm, ± 95 %"),
        rows=tuple(
            (
                NAMES[ptosis.name],
                ptosis.grade,
                ", ".join(ptosis.likely),
                at_95(ptosis.nipple_below_fold_mm, ptosis.sigma_mm, sign=True),
            )
            for ptosis in dimensions.ptosis
        ),
    )
    marks = TextTable(
        title="Landmarks",
        columns=("landmark", "how it was found", "σ, mm", "probability"),
        rows=tuple(
            (
                landmark.name.replace("_", " "),
                sentence(landmark.method),
                f"{landmark.sigma_mm:.1f}",
                f"{landmark.probability:.2f}",
            )
            for landmark in landmarks
        ),
    )
    return tuple(table for table in (lengths, shapes, quadrants, sunk, marks) if table.rows)
