"""Describe products as text, numbers and tables of a report."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from mammometry.base.machine.cores import available_cores
from mammometry.base.notices.words import NAMES, words_of
from mammometry.base.rounding import half_width, rounded_words
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.quality import CalibrationQuality
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Float32, Rig, bounds
from mammometry.geometry.nearest import point_tree
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.quality import MatchQuality
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.settings import NOT_TO_BE_COMPARED
from mammometry.measure.volume.attribution import curve_digest
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.content import BreastReport, Fact, LargeNumber, Meaning, StageReport, sentence
from mammometry.report.figures.shading import wall_faces
from mammometry.report.figures.surface import provenance_shares
from mammometry.report.figures.thinning import ThinnedRange
from mammometry.report.words.volumes import (
    MEANINGS,
    definition_words,
    meaning_sentences,
    meaning_title,
    span_words,
    term_words,
    volume_words,
)
from mammometry.settings import Settings, as_table
from mammometry.study.tables import TextTable, number, signed, thousands
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "scikit-image", "trimesh", "manifold3d")


def breast_report(measured: VolumeMeasurement, repaired: RepairedSurface | None = None) -> BreastReport:
    """Describe one measurement as text.

    Args:
        measured: one breast.
        repaired: the whole surface, which has the origin of the skin.
    """
    facts = [
        Fact("Projection", f"{measured.projection_mm:.1f} mm"),
        Fact("Skin within the boundary", f"{measured.area_cm2:.0f} cm²"),
        Fact("Base area", f"{measured.base_area_cm2:.0f} cm²"),
    ]
    shares = None if repaired is None else skin_shares(measured, repaired)
    if shares is not None:
        facts.append(Fact("Skin", _shares_words(shares)))
    if not measured.watertight:
        facts.append(Fact("Closed solid", "NOT watertight: do not use this volume"))
    return BreastReport(
        name=measured.name,
        wall_label=wall_label(measured),
        title=side_title(measured.name),
        number=LargeNumber(
            title=side_title(measured.name),
            value=volume_words(measured.volume_cc, measured.interval_cc),
            interval=span_words(measured.interval_cc),
            note=MEANINGS[measured.definitions[0].meaning if measured.definitions else "closed solid"]
            if measured.definitions or measured.name == "model"
            else "",
        ),
        interval_note=sentence(measured.interval_note),
        facts=tuple(facts),
        wall=f"{measured.wall_kind.capitalize()}: {sentence(measured.wall_definition, capital=False)}",
        boundary=measured.boundary_method,
        boundary_remarks=measured.boundary_remarks,
        curve=curve_digest(measured.boundary_world),
        tables=_breast_tables(measured),
    )


def side_title(name: str) -> str:
    """Title of a breast on a page, or of the cast."""
    return "Model" if name == "model" else f"{name.capitalize()} breast"


def meanings(measurements: Sequence[VolumeMeasurement]) -> tuple[Meaning, ...]:
    """The volumes with every definition of the breast."""
    facts: dict[str, list[Fact]] = {}
    walls: dict[str, str] = {}
    for measured in measurements:
        for defined in measured.definitions:
            words = Fact(side_title(measured.name), definition_words(defined))
            facts.setdefault(defined.meaning, []).append(words)
            walls[defined.meaning] = measured.wall_kind
    return tuple(
        Meaning(title=meaning_title(name), sentences=meaning_sentences(name, walls[name]), volumes=tuple(volumes))
        for name, volumes in facts.items()
    )


def absent_report(absent: NoBreast) -> BreastReport:
    """Content for a side without a breast. The reason is a warning."""
    seen = absent.prominence
    facts = () if seen is None else (Fact("Largest possible volume there", f"{seen.volume_cc:.0f} cc"),)
    return BreastReport(
        name=absent.name,
        title=f"{absent.name.capitalize()} side",
        number=LargeNumber(
            title=side_title(absent.name),
            value="not measured" if absent.unclear or absent.refused else "none",
            interval=_without(absent),
        ),
        facts=facts,
        absence=absent.reason,
    )


def _without(absent: NoBreast) -> str:
    if absent.refused:
        return "The volume was refused"
    return "It is not clear whether this is a breast" if absent.unclear else "No breast on this side"


def wall_label(measured: VolumeMeasurement) -> str:
    """Name of the surface at the back: chest wall, or base of a cast."""
    return "Chest wall" if measured.name != "model" else "Base"


def _breast_tables(measured: VolumeMeasurement) -> tuple[TextTable, ...]:
    wall, half = wall_label(measured).lower(), half_width(measured.interval_cc)
    terms = TextTable(
        title="Where the error comes from",
        columns=("source of error", "± cc (95 %)"),
        rows=tuple((name, term_words(value)) for name, value in measured.interval_terms_cc.items()),
    )
    walls = TextTable(
        title=f"Volume with other {'chest walls' if measured.name != 'model' else 'bases'}",
        columns=(wall, "cc", f"difference from {measured.wall_kind}, cc"),
        rows=tuple(
            (
                kind,
                rounded_words(value, half, alone=True),
                rounded_words(value - measured.volume_cc, half, sign=True, alone=True),
            )
            for kind, value in measured.alternatives_cc.items()
        ),
    )
    return tuple(table for table in (terms, walls) if table.rows)


def calibration_report(rig: Rig, calibration: Calibration | None, quality: CalibrationQuality | None) -> StageReport:
    """The calibration as text and numbers."""
    title = "Calibration"
    if calibration is None or quality is None:
        imported = Fact("Cameras", f"{len(rig.cameras)}, imported. Their errors are not known")
        return StageReport(stage="calibrate", title=title, facts=(imported,), tables=(_camera_table(rig, None),))
    observations = calibration.observations
    used = sum(int(np.isfinite(part).all(axis=1).sum()) for part in calibration.residuals_px)
    total = sum(len(part) for part in calibration.residuals_px)
    facts = (
        Fact("Verdict", quality.verdict),
        Fact("Reasons", "\n".join(map(words_of, quality.notices))),
        Fact("Target", target_words(observations.target)),
        Fact(
            "Photographs",
            f"{len(observations.detections)}, in {len(observations.poses)} poses, by {len(observations.cameras)} "
            "cameras",
        ),
        Fact("Points", f"{thousands(used)} used, {thousands(total - used)} left out"),
        Fact("Reprojection error (RMS)", f"{calibration.rms_px:.3f} px, {quality.rms_mm:.3f} mm at the target"),
    )
    pairs = TextTable(
        title="How well each pair measures the target",
        columns=("pair", "poses seen by both", "scale error, ppm", "shape error, mm", "flatness, mm"),
        rows=tuple(
            (
                pair.pair,
                str(pair.poses),
                signed(pair.scale_ppm, 0),
                number(pair.geometry_mm, ".3f"),
                number(pair.planarity_mm, ".3f"),
            )
            for pair in quality.pairs
        ),
    )
    return StageReport(stage="calibrate", title=title, facts=facts, tables=(pairs, _camera_table(rig, quality)))


def matching_report(
    foregrounds: Mapping[str, Foreground], matching: Mapping[str, MatchQuality], shares: Mapping[str, float]
) -> StageReport:
    """The matching in numbers."""
    rows = []
    for name, judged in matching.items():
        width, height = judged.size_wh
        some = judged.matched_pixels > 0
        rows.append(
            (
                name,
                f"{width} × {height}",
                f"{100 * shares[name]:.1f}" if name in shares else "–",
                f"{judged.weak_percent:.1f}",
                f"{judged.confidence_median:.2f}" if some else "–",
                f"{judged.sigma_median_px:.3f}" if some else "–",
                f"{number(judged.d_v_median_px, '+.3f')} ± {judged.d_v_spread_px:.3f}",
            )
        )
    table = TextTable(
        title="Pairs",
        columns=(
            "pair",
            "size, px",
            "matched, % of silhouette",
            "texture too weak, %",
            "correlation (median)",
            "σ (median), px",
            "vertical disparity, px (68 %)",
        ),
        rows=tuple(rows),
    )
    known = sum(not foreground.everything for foreground in foregrounds.values())
    facts = (Fact("Silhouettes", f"found in {known} of {len(foregrounds)} photographs"),)
    return StageReport(stage="match", title="Matching", facts=facts, tables=(table,))


def _shares_words(shares: Mapping[Provenance, float]) -> str:
    kinds = (Provenance.MEASURED, Provenance.REPAIRED, Provenance.BRIDGED, Provenance.INVENTED)
    return ", ".join(f"{100 * shares[kind]:.1f} % {kind.name.lower()}" for kind in kinds)


def surface_report(
    ranges: Sequence[ThinnedRange], repaired: RepairedSurface, stillness: str = "not compared"
) -> StageReport:
    """The surface in numbers."""
    mesh = repaired.mesh
    closed = mesh.is_watertight()
    shares = provenance_shares(repaired)
    area_cm2 = mesh.area_mm2() / 100
    bridged_cm2 = area_cm2 * shares[Provenance.BRIDGED]
    closed_cm2 = bridged_cm2 + area_cm2 * shares[Provenance.INVENTED]
    facts = (
        Fact(
            "Mesh",
            f"{thousands(len(mesh.vertices))} vertices, {thousands(len(mesh.faces))} triangles, {area_cm2:.0f} cm²",
        ),
        Fact("Cameras and body", stillness),
        Fact("Topology", f"{'watertight' if closed else 'open'}, Euler number {mesh.euler_number()}"),
        Fact(
            "Self-intersections",
            "not checked" if repaired.crossings is None else f"{thousands(repaired.crossings)} pairs of triangles",
        ),
        Fact("Area", _shares_words(shares)),
        Fact(
            "Closed without measurement",
            f"{closed_cm2:.0f} cm², {bridged_cm2:.0f} cm² of them between or next to measured skin; grey in "
            "photographic colours",
        ),
        Fact("Movement in each repair round", ", ".join(f"{moved:.3g} mm" for moved in repaired.convergence) or "none"),
    )
    rows = [
        (
            image.name,
            thousands(len(image.ranges_mm)),
            f"{100 * (1 - image.kept_count / max(len(image.ranges_mm), 1)):.1f}",
            _range_words(image.ranges_mm),
            "–" if image.sigma_median_mm is None else f"{image.sigma_median_mm:.3f}",
        )
        for image in ranges
    ]
    table = TextTable(
        title="Range images",
        columns=("pair", "points", "dropped, %", "distance, mm", "σ (median), mm"),
        rows=tuple(rows),
    )
    return StageReport(stage="surface", title="Surface", facts=facts, tables=(table,))


def posture_fact(posture: str) -> Fact:
    """The patient's posture, if known."""
    return Fact("Posture", f"{posture or 'not given'}. {NOT_TO_BE_COMPARED}")


def measure_report(measurements: Sequence[VolumeMeasurement]) -> StageReport:
    """The measurement in numbers: the solids whose volumes were computed."""
    facts = tuple(
        Fact(
            NAMES[measured.name][:1].upper() + NAMES[measured.name][1:],
            f"{measured.volume_cc:.2f} cc before rounding, {thousands(len(measured.closed.faces))} triangles, "
            f"{'watertight' if measured.watertight else 'NOT watertight'}, closed by {measured.wall_kind}",
        )
        for measured in measurements
    )
    return StageReport(stage="measure", title="Measurement", facts=facts)


def settings_facts(settings: Settings) -> tuple[tuple[Fact, ...], tuple[Fact, ...]]:
    """Changed settings, and all settings, by their dotted names."""
    mine, recommended = dict(_flat(as_table(settings))), dict(_flat(as_table(Settings())))
    everything = tuple(Fact(name, _value_words(value)) for name, value in mine.items())
    changed = tuple(
        Fact(name, f"{_value_words(value)} (recommended: {_value_words(recommended.get(name))})")
        for name, value in mine.items()
        if value != recommended.get(name)
    )
    return changed, everything


def versions() -> tuple[Fact, ...]:
    """Versions of all software that affects the numbers."""
    import mammometry

    return (
        Fact("mammometry", mammometry.__version__),
        Fact("Python", platform.python_version()),
        *(Fact(name, version(name)) for name in _PACKAGES),
        Fact("system", f"{platform.system()} {platform.machine()}"),
    )


def timings(stage_seconds: Mapping[str, float]) -> tuple[Fact, ...]:
    """Seconds of each stage as text."""
    facts = [Fact(stage, f"{seconds:.1f} s") for stage, seconds in stage_seconds.items()]
    return (*facts, Fact("total", f"{sum(stage_seconds.values()):.1f} s")) if facts else ()


def created_words(moment: datetime | None = None) -> str:
    """A time as text, UTC, to the minute."""
    return (moment or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC")


SUBJECTS: Mapping[str, str] = {
    "model": "a cast: one closed solid",
    "torso": "a torso",
    "surface": "an open surface, which has no volume",
}


def target_words(target: Target) -> str:
    """The calibration target as text."""
    table = ", ".join(
        _with_unit(name, _value_words(value))
        for name, value in as_table(target).items()
        if name != "points_mm" and value is not None and value is not False
    )
    return f"{target.kind}: {table}" if table else f"{target.kind}: {len(target.points_target)} points"


def _with_unit(name: str, value: str) -> str:
    """Separate the unit of a length: ``square_mm``, ``25`` → "square 25 mm"."""
    return f"{name.removesuffix('_mm').replace('_', ' ')} {value}{' mm' if name.endswith('_mm') else ''}"


def _camera_table(rig: Rig, quality: CalibrationQuality | None) -> TextTable:
    rows = []
    for name, camera in rig.cameras.items():
        row: tuple[str, ...] = (
            name,
            f"{camera.size_wh[0]} × {camera.size_wh[1]}",
            f"{camera.matrix[0, 0]:.2f}",
            f"{camera.matrix[0, 2]:.2f}, {camera.matrix[1, 2]:.2f}",
            ", ".join(number(value, ".3f") for value in camera.distortion[:2]),
        )
        if quality is not None:
            row += (
                number(quality.rms_px_per_camera.get(name, np.nan), ".3f"),
                number(1e6 * quality.focal_std.get(name, np.nan), ".0f"),
                number(100 * quality.coverage.get(name, np.nan), ".0f"),
            )
        rows.append(row)
    judged = () if quality is None else ("RMS, px", "σ of focal length, ppm", "picture covered, %")
    columns = ("camera", "size, px", "focal length, px", "principal point, px", "k1, k2", *judged)
    return TextTable(title="Cameras", columns=columns, rows=tuple(rows))


def _range_words(values: Float32[Array, " n"]) -> str:
    return f"{values.min():.0f}–{values.max():.0f}" if len(values) else "–"


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _value_words(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return " × ".join(map(_value_words, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


SKIN_MEASURED = 0.8
"""Measured share of a breast's skin below which there is a warning. It has no other effect."""


_AROUND_MM = 10.0  # margin around a breast within which the surface's vertices are searched


def skin_shares(measured: VolumeMeasurement, repaired: RepairedSurface) -> dict[Provenance, float]:
    """Share of a breast's skin with each provenance.

    The provenance is that of the nearest vertex of the whole surface.
    """
    skin = ~wall_faces(measured)
    middles = measured.closed.corners()[skin].mean(axis=1)
    areas = np.linalg.norm(measured.closed.face_vectors()[skin], axis=1)
    low, high = bounds(middles)
    near = repaired.mesh.vertices_between(low - _AROUND_MM, high + _AROUND_MM)
    near = near if len(near) else np.arange(len(repaired.mesh.vertices))
    nearest = point_tree(repaired.mesh.vertices[near]).query(middles, workers=available_cores())[1]
    sums = np.bincount(repaired.provenance[near[nearest]], areas, minlength=len(Provenance))
    return {kind: float(sums[kind] / max(areas.sum(), 1e-12)) for kind in Provenance}
