"""What the report says: every number in words with its unit, every warning, before anything is laid out."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from mammometry.base.identity import Identity
from mammometry.calibration.adjust.bundle import Calibration
from mammometry.calibration.judge.quality import CalibrationQuality
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, Float32
from mammometry.geometry.camera import Rig
from mammometry.matching import quality as match_quality
from mammometry.matching.foreground import Foreground
from mammometry.matching.match import DisparityMap
from mammometry.measure.boundary.boundary import TO_BE_CONFIRMED
from mammometry.measure.volume.volume import VolumeMeasurement
from mammometry.report.figures.canvas import thousands
from mammometry.report.figures.sides import NAMES, wall_faces
from mammometry.report.figures.surface import provenance_shares
from mammometry.report.scene import ViewerScene
from mammometry.report.volume_words import interval_words, is_coarse, volume_words
from mammometry.settings import Settings, as_table
from mammometry.surface.dents import ValidPatches
from mammometry.surface.range_image import RangeImage
from mammometry.surface.repair import Provenance, RepairedSurface

DISCLAIMER = (
    "For research use only. mammometry is not a certified medical device: it must not be the basis of a diagnosis or "
    "of a treatment."
)
_MATCHED_WARN = 0.6
"""Share of a silhouette that a pair should match at least: obliquely seen flanks alone cost up to a third."""
_SKIN_MEASURED_WARN = 0.8
"""Share of a breast's skin that should be measured and not closed by the elastic model."""
_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "scikit-image", "trimesh", "manifold3d", "pyamg")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fact:
    """One line of a list: what, and its value in words."""

    label: str
    value: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A small table; all cells are text."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class BreastReport:
    """One measured breast, in words."""

    name: str
    """model, left, right."""
    title: str
    """What to call it."""
    volume: str
    """"354 cc"."""
    interval: str
    """The 95 % interval, or that there is none yet."""
    interval_note: str
    facts: tuple[Fact, ...]
    """What goes with the volume."""
    wall: str
    """Name and definition of the wall."""
    boundary: str
    """How the boundary was found."""
    tables: tuple[Table, ...] = ()
    """What the interval consists of, and the volume with other walls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StageReport:
    """One stage, for the technician."""

    stage: str
    title: str
    facts: tuple[Fact, ...]
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportContent:
    """Everything that the report says and shows."""

    identity: Identity
    """Whose results; the only names on the page."""
    created: str
    """When the report was made, in words."""
    subject: str
    """What was photographed, in words."""
    world: str
    """What the world frame is."""
    warnings: tuple[str, ...]
    """The gravest first."""
    breasts: tuple[BreastReport, ...]
    comparison: tuple[Fact, ...]
    """Differences between both breasts; empty without both."""
    stages: tuple[StageReport, ...]
    timings: tuple[Fact, ...]
    changed_settings: tuple[Fact, ...]
    """Those that differ from the recommended ones."""
    all_settings: tuple[Fact, ...]
    versions: tuple[Fact, ...]
    pictures: Mapping[str, Mapping[str, bytes]] = field(default_factory=dict)
    """Stage → name → PNG with its caption inside (`figures`)."""
    scene: ViewerScene | None = None
    """What the 3D viewer shows; None leaves it out."""
    key: str = ""
    """Digest of all that the page shows; tells whether it still shows what is there."""
    contains: str = "photographs of the subject, but no name beyond those in its heading"
    """What the report gives away of the subject."""

    @property
    def about(self) -> str:
        """What stands below the heading."""
        return " · ".join(filter(None, (self.identity.beside, self.created, self.subject)))


def breast_report(measured: VolumeMeasurement, repaired: RepairedSurface | None = None) -> BreastReport:
    """One measurement in words."""
    facts = (
        []
        if measured.as_defined_cc is None
        else [Fact(label="With this wall taken as given", value=interval_words(measured.as_defined_cc))]
    )
    facts += [
        Fact(label="Projection", value=f"{measured.projection_mm:.1f} mm"),
        Fact(label="Skin within the boundary", value=f"{measured.area_cm2:.0f} cm²"),
        Fact(label="Base area", value=f"{measured.base_area_cm2:.0f} cm²"),
    ]
    if repaired is not None:
        shares = skin_shares(measured, repaired)
        seen, mended, invented = (100 * shares[kind] for kind in sorted(Provenance, reverse=True))
        facts.append(
            Fact(label="Skin measured", value=f"{seen:.1f} %, repaired {mended:.1f} %, invented {invented:.1f} %")
        )
    facts.append(Fact(label="Chest wall" if measured.name != "model" else "Base", value=measured.wall_kind))
    if not measured.watertight:
        facts.append(Fact(label="Closed solid", value="NOT watertight"))
    return BreastReport(
        name=measured.name,
        title=NAMES[measured.name][:1].upper() + NAMES[measured.name][1:],
        volume=volume_words(measured.volume_cc, measured.interval_cc),
        interval=interval_words(measured.interval_cc),
        interval_note=sentence(measured.interval_note),
        facts=tuple(facts),
        wall=f"{measured.wall_kind.capitalize()}: {sentence(measured.wall_definition, capital=False)}",
        boundary=sentence(measured.boundary_method),
        tables=_breast_tables(measured),
    )


def _breast_tables(measured: VolumeMeasurement) -> tuple[Table, ...]:
    terms = Table(
        title="Where the interval comes from",
        columns=("source of error", "± cc (95 %)"),
        rows=tuple((name, _term_words(value)) for name, value in measured.interval_terms_cc.items()),
    )
    walls = Table(
        title="The volume, were the wall drawn otherwise",
        columns=("wall", "cc", f"against {measured.wall_kind}, cc"),
        rows=tuple(
            (
                kind,
                volume_words(value, measured.interval_cc).removesuffix(" cc"),
                _number(value - measured.volume_cc, "+.0f" if is_coarse(measured.interval_cc) else "+.1f"),
            )
            for kind, value in measured.alternatives_cc.items()
        ),
    )
    return tuple(table for table in (terms, walls) if table.rows)


def _term_words(value_cc: float) -> str:
    return "< 0.1" if value_cc < 0.05 else f"{value_cc:.{1 if value_cc < 10 else 0}f}"


def skin_shares(measured: VolumeMeasurement, repaired: RepairedSurface) -> dict[Provenance, float]:
    """Share of a breast's skin of each origin, by the nearest vertex of the surface that it was cut from."""
    from scipy.spatial import cKDTree

    skin = ~wall_faces(measured)
    middles = measured.closed.corners()[skin].mean(axis=1)
    areas = np.linalg.norm(measured.closed.face_vectors()[skin], axis=1)
    nearest = cKDTree(repaired.mesh.vertices).query(middles, workers=1)[1]
    sums = np.bincount(repaired.provenance[nearest], areas, minlength=len(Provenance))
    return {kind: float(sums[kind] / max(areas.sum(), 1e-12)) for kind in Provenance}


def calibration_report(rig: Rig, calibration: Calibration | None, quality: CalibrationQuality | None) -> StageReport:
    """The calibrate stage in words and numbers."""
    title = "Calibration"
    if calibration is None or quality is None:
        imported = Fact(label="Cameras", value=f"{len(rig.cameras)}, imported ready-made; their errors are not known")
        return StageReport(stage="calibrate", title=title, facts=(imported,), tables=(_camera_table(rig, None),))
    observations = calibration.observations
    used = sum(int(np.isfinite(part).all(axis=1).sum()) for part in calibration.residuals_px)
    total = sum(len(part) for part in calibration.residuals_px)
    facts = (
        Fact(label="Verdict", value=quality.verdict),
        Fact(label="Because", value=" ".join(map(sentence, quality.reasons))),
        Fact(label="Target", value=target_words(observations.target)),
        Fact(
            label="Seen",
            value=f"{len(observations.poses)} poses by {len(observations.cameras)} cameras, "
            f"{len(observations.detections)} views",
        ),
        Fact(label="Points", value=f"{thousands(used)} used, {thousands(total - used)} left out"),
        Fact(
            label="Reprojection error (RMS)",
            value=f"{calibration.rms_px:.3f} px, {quality.rms_mm:.3f} mm at the target",
        ),
    )
    pairs = Table(
        title="The target, reconstructed by each pair",
        columns=("pair", "common poses", "scale error, ppm", "shape error, mm", "flatness, mm"),
        rows=tuple(
            (
                pair.pair,
                str(pair.poses),
                _number(pair.scale_ppm, "+.0f"),
                _number(pair.geometry_mm, ".3f"),
                "–" if pair.planarity_mm is None else _number(pair.planarity_mm, ".3f"),
            )
            for pair in quality.pairs
        ),
    )
    return StageReport(stage="calibrate", title=title, facts=facts, tables=(pairs, _camera_table(rig, quality)))


def matching_report(
    foregrounds: Mapping[str, Foreground], disparities: Mapping[str, DisparityMap], shares: Mapping[str, float]
) -> StageReport:
    """The match stage in numbers."""
    rows = []
    for name, found in disparities.items():
        judged = match_quality.assess(found)
        rows.append(
            (
                name,
                f"{found.valid.shape[1]} × {found.valid.shape[0]}",
                f"{100 * shares[name]:.1f}",
                f"{judged.weak_percent:.1f}",
                _median_words(found.confidence[found.valid], ".2f"),
                _median_words(found.sigma_px[found.valid], ".3f"),
                f"{_number(judged.d_v_median_px, '+.3f')} ± {judged.d_v_spread_px:.3f}",
            )
        )
    table = Table(
        title="Pairs",
        columns=(
            "pair",
            "size, px",
            "matched, % of silhouette",
            "too weak a texture, %",
            "median correlation",
            "median σ, px",
            "vertical disparity, px (68 %)",
        ),
        rows=tuple(rows),
    )
    known = sum(not found.everything for found in foregrounds.values())
    facts = (Fact(label="Silhouettes", value=f"known in {known} of {len(foregrounds)} photographs"),)
    return StageReport(stage="match", title="Matching", facts=facts, tables=(table,))


def surface_report(ranges: Mapping[str, RangeImage], valid: ValidPatches, repaired: RepairedSurface) -> StageReport:
    """The surface stage in numbers."""
    mesh = repaired.mesh
    closed = mesh.is_watertight()
    shares = provenance_shares(repaired)
    facts = (
        Fact(
            label="Mesh",
            value=f"{thousands(len(mesh.vertices))} vertices, {thousands(len(mesh.faces))} triangles, "
            f"{mesh.area_mm2() / 100:.0f} cm²",
        ),
        Fact(label="Topology", value=f"{'watertight' if closed else 'open'}, Euler number {mesh.euler_number()}"),
        Fact(
            label="Self-intersections",
            value="not looked for"
            if repaired.crossings is None
            else f"{thousands(repaired.crossings)} pairs of triangles",
        ),
        Fact(
            label="Area",
            value=", ".join(
                f"{100 * shares[kind]:.1f} % {kind.name.lower()}" for kind in sorted(Provenance, reverse=True)
            ),
        ),
        Fact(
            label="Movement in each round of the repair",
            value=", ".join(f"{moved:.3g} mm" for moved in repaired.convergence) or "none",
        ),
    )
    rows = []
    for kept in valid.range_images:
        before = ranges[kept.name]
        count = int(before.valid.sum())
        rows.append(
            (
                kept.name,
                thousands(count),
                f"{100 * (1 - int(kept.valid.sum()) / max(count, 1)):.1f}",
                _range_words(before.range_mm[before.valid]),
                _median_words(before.sigma_mm[before.valid], ".3f"),
            )
        )
    table = Table(
        title="Range images",
        columns=("pair", "points", "dropped, %", "distance, mm", "median σ, mm"),
        rows=tuple(rows),
    )
    return StageReport(stage="surface", title="Surface", facts=facts, tables=(table,))


def measure_report(measurements: Sequence[VolumeMeasurement]) -> StageReport:
    """The measure stage: what was integrated."""
    facts = tuple(
        Fact(
            label=NAMES[measured.name][:1].upper() + NAMES[measured.name][1:],
            value=f"{measured.volume_cc:.2f} cc before rounding, {thousands(len(measured.closed.faces))} triangles, "
            f"{'watertight' if measured.watertight else 'NOT watertight'}, wall {measured.wall_kind}",
        )
        for measured in measurements
    )
    return StageReport(stage="measure", title="Measurement", facts=facts)


def warnings(
    *,
    quality: CalibrationQuality | None,
    calibration: Calibration | None,
    shares: Mapping[str, float],
    disparities: Mapping[str, DisparityMap],
    foregrounds: Mapping[str, Foreground],
    measurements: Sequence[VolumeMeasurement],
    repaired: RepairedSurface,
) -> Iterator[str]:
    """Whatever a reader must know before the numbers, the gravest first."""
    for measured in measurements:
        if not measured.watertight:
            yield f"The closed solid of the {NAMES[measured.name]} is not watertight: its volume is not to be trusted."
    unconfirmed = [NAMES[measured.name] for measured in measurements if TO_BE_CONFIRMED in measured.boundary_method]
    if unconfirmed:
        yield (
            f"The boundary of the {' and of the '.join(unconfirmed)} is automatic and to be confirmed: look at it, and "
            "confirm it, or draw a better one, with “mammometry edit”."
        )
    if quality is not None and quality.verdict != "pass":
        yield f"The calibration deserves a look ({quality.verdict}): {sentence(quality.reasons[0], capital=False)}"
    for away in calibration.set_aside if calibration is not None else ():
        yield (
            f"Calibration pose {away.pose} of camera {away.camera} was set aside: it misses the others by "
            f"{away.residual_px:.1f} px."
        )
    if calibration is None:
        yield "The cameras were imported ready-made: what their errors add to the volume is not known."
    for name, found in disparities.items():
        yield from match_quality.concerns(name, match_quality.assess(found))
    for name, share in shares.items():
        if share < _MATCHED_WARN:
            yield f"Pair {name}: only {100 * share:.0f} % of the subject's silhouette could be matched."
    blind = [name for name, known in foregrounds.items() if known.everything]
    if blind:
        yield f"No silhouettes are known in {', '.join(blind)}: unseen parts of the surface are bounded by nothing."
    for measured in measurements:
        share = skin_shares(measured, repaired)[Provenance.MEASURED]
        if share < _SKIN_MEASURED_WARN:
            yield (
                f"Only {100 * share:.0f} % of the skin of the {NAMES[measured.name]} was measured; the rest was "
                "closed by the elastic model."
            )


def settings_facts(settings: Settings) -> tuple[tuple[Fact, ...], tuple[Fact, ...]]:
    """Settings that differ from the recommended ones, and all of them, by their dotted names."""
    mine, recommended = dict(_flat(as_table(settings))), dict(_flat(as_table(Settings())))
    everything = tuple(Fact(label=name, value=_value_words(value)) for name, value in mine.items())
    changed = tuple(
        Fact(label=name, value=f"{_value_words(value)} (recommended: {_value_words(recommended.get(name))})")
        for name, value in mine.items()
        if value != recommended.get(name)
    )
    return changed, everything


def versions() -> tuple[Fact, ...]:
    """Versions of everything that numbers depend on."""
    import mammometry

    return (
        Fact(label="mammometry", value=mammometry.__version__),
        Fact(label="Python", value=platform.python_version()),
        *(Fact(label=name, value=version(name)) for name in _PACKAGES),
        Fact(label="system", value=f"{platform.system()} {platform.machine()}"),
    )


def timings(stage_seconds: Mapping[str, float]) -> tuple[Fact, ...]:
    """Seconds of each stage in words."""
    facts = [Fact(label=stage, value=f"{seconds:.1f} s") for stage, seconds in stage_seconds.items()]
    return (*facts, Fact(label="together", value=f"{sum(stage_seconds.values()):.1f} s")) if facts else ()


def created_words(moment: datetime | None = None) -> str:
    """A moment in words, UTC, to the minute."""
    return (moment or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC")


SUBJECTS: Mapping[str, str] = {
    "model": "a cast: one closed solid",
    "torso": "a torso: both breasts",
    "surface": "an open surface: nothing to measure the volume of",
}


def target_words(target: Target) -> str:
    """The calibration target in words."""
    table = ", ".join(
        f"{name.replace('_', ' ')} {_value_words(value)}"
        for name, value in as_table(target).items()
        if name != "points_mm" and value is not None and value is not False
    )
    return f"{target.kind}: {table}" if table else f"{target.kind}: {len(target.points_target)} points"


def sentence(text: str, *, capital: bool = True) -> str:
    """The text as a sentence: a full stop at its end, and a capital at its beginning unless it continues another."""
    text = text.strip().rstrip(".")
    return f"{text[:1].upper() if capital else text[:1]}{text[1:]}." if text else ""


def _camera_table(rig: Rig, quality: CalibrationQuality | None) -> Table:
    rows = []
    for name, camera in rig.cameras.items():
        row: tuple[str, ...] = (
            name,
            f"{camera.size_wh[0]} × {camera.size_wh[1]}",
            f"{camera.matrix[0, 0]:.2f}",
            f"{camera.matrix[0, 2]:.2f}, {camera.matrix[1, 2]:.2f}",
            ", ".join(_number(value, ".3f") for value in camera.distortion[:2]),
        )
        if quality is not None:
            row += (
                _number(quality.rms_px_per_camera.get(name, np.nan), ".3f"),
                _number(1e6 * quality.focal_std.get(name, np.nan), ".0f"),
                _number(100 * quality.coverage.get(name, np.nan), ".0f"),
            )
        rows.append(row)
    judged = () if quality is None else ("RMS, px", "σ of focal length, ppm", "picture covered, %")
    columns = ("camera", "size, px", "focal length, px", "principal point, px", "k1, k2", *judged)
    return Table(title="Cameras", columns=columns, rows=tuple(rows))


def _number(value: float, form: str) -> str:
    return format(value, form).replace("-", "−") if np.isfinite(value) else "–"


def _median_words(values: Float32[Array, " n"], form: str) -> str:
    return format(float(np.median(values)), form) if len(values) else "–"


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
