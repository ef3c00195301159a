"""Two dates of one torso: alignment of the trunk, error of the change, refusals.

    python -m benchmarks.accuracy.dates --torsos 24

No photographs. Each torso is made twice: as it was, and with one breast grown or shrunk by a known volume, in the
same pose or in another (lean, arms and breath drawn again). First with true skin and true boundaries, so that nothing
but the chest wall differs: what the walls of both dates do not share, as `sources.WALL_SAME_POSE_U95_MM` and
`WALL_ACROSS_POSES_U95_MM` are defined. Then with errors drawn as the stages make them and boundaries drawn by another
hand at each date: whether the interval of the change holds the true one, how often an unchanged breast is called
changed, and how often a changed one is found. Last, other bodies' trunks, and one body's in extreme poses, for the
limits of `CompareSettings`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.accuracy.coverage import EARLIER, disturbed
from benchmarks.accuracy.walls import TrueTorso, as_seen, true_boundaries
from mammometry.base.errors import MeasureError
from mammometry.geometry.transform import Transform
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.change import Change, DatedMeasurements, TrunkFit, TrunkSkin, compare, fit_trunks, trunk_of
from mammometry.measure.settings import CompareSettings, MeasureSettings
from mammometry.measure.trunk.thorax import frame_from_sides, seen_skin
from mammometry.measure.volume.boundary_jitter import displacements_mm, redraw
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.uncertainty import VolumeEvidence
from mammometry.measure.volume.volumes import measure_volumes
from mammometry.measure.wall.chest_wall import fit
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.simulate.subjects.solid import rig_from_solid
from mammometry.simulate.subjects.torso import torso
from mammometry.simulate.subjects.torso_shape import TorsoShape, torso_shape

SIDES = ("left", "right")
_UPRIGHT = np.array([0.0, 1.0, 0.0])
_SCALE_STD = 1e-3
_LEAN_DEG, _ARM_DEG, _BREATH = 4.0, 8.0, 0.012
_GROWTH = 0.2
POSES = ("same pose", "across poses")


@dataclass(frozen=True)
class TrueVisit:
    """A torso in front of the cameras, with its pose."""

    torso: TrueTorso
    rig_from_solid: Transform

    def volume_cc(self, side: str) -> float:
        """Exact volume of a breast, cc."""
        return self.torso.solid.closed_breast(side).volume_mm3() / 1000


@dataclass(frozen=True)
class Row:
    """Measured and true change of one breast between two dates."""

    pairing: str
    true_cc: float
    """True change, cc."""
    error_cc: float
    half_cc: float
    """Half width of the 95 % interval."""
    volumes_half_cc: tuple[float, float]
    """Half widths of both volumes' intervals, cc."""
    beyond: bool
    """Verdict."""
    wall_mm: float
    """|error| with true skin and true boundaries over √((A² + A²)/2), mm."""


def true_visit(shape: TorsoShape, name: str, place: int, *, edge_mm: float = 2.5) -> TrueVisit:
    """A torso with a random pose; `place` is its seed."""
    solid = torso(shape, name=name, seed=0, edge_mm=edge_mm)
    motion = rig_from_solid(solid, place)
    solid = solid.placed(motion)
    subject = TrueTorso(
        solid=solid, surface=as_seen(solid.mesh), boundaries=true_boundaries(solid, solid.mesh.vertices)
    )
    return TrueVisit(torso=subject, rig_from_solid=motion)


def grown(shape: TorsoShape, factors: Mapping[str, float]) -> TorsoShape:
    """A torso with some breasts scaled to another volume."""
    breasts = dict(shape.breasts)
    for side, factor in factors.items():
        one = breasts[side]
        breasts[side] = replace(
            one,
            volume_cc=one.volume_cc * factor,
            radii_mm=tuple(radius * factor**0.15 for radius in one.radii_mm),
            projection_mm=one.projection_mm * factor**0.6,
            hang_mm=one.hang_mm * factor**0.5,
        )
    return replace(shape, breasts=breasts)


def posed(shape: TorsoShape, lean_deg: float, arms_deg: tuple[float, float], breath: float) -> TorsoShape:
    """A body in another pose: lean, arms out and back, chest deeper by a share."""
    body = shape.body
    body = replace(
        body,
        arm_out_rad=body.arm_out_rad + math.radians(arms_deg[0]),
        arm_back_rad=max(0.0, body.arm_back_rad + math.radians(arms_deg[1])),
        depth=body.depth * (1.0 + breath),
    )
    return replace(shape, body=body, lean_rad=shape.lean_rad + math.radians(lean_deg))


def otherwise(shape: TorsoShape, rng: np.random.Generator) -> TorsoShape:
    """A random pose, as patients vary."""
    arms = rng.normal(0.0, _ARM_DEG, 2)
    return posed(shape, rng.normal(0.0, _LEAN_DEG), (arms[0], arms[1]), rng.normal(0.0, _BREATH))


def as_measured(
    true: TrueVisit, settings: MeasureSettings = MeasureSettings(), rng: np.random.Generator | None = None
) -> DatedMeasurements:
    """A visit with true skin and boundaries. With a generator, both have random errors."""
    surface, boundaries = true.torso.surface, true.torso.boundaries
    if rng is not None:
        scale = 1 + _SCALE_STD * rng.normal()
        surface = replace(surface, mesh=disturbed(surface.mesh, scale, rng))
        drawn = []
        for boundary in boundaries:
            modes = displacements_mm(np.full(len(boundary.points_world), settings.observers.mean_mm))
            moved = replace(boundary, points_world=boundary.points_world * scale)
            drawn.append(redraw(moved, rng.normal(size=len(modes)) @ modes, surface.mesh))
        boundaries = tuple(drawn)
    found = measure_volumes(open_breasts(boundaries, surface, settings), VolumeEvidence(earlier=EARLIER))
    return DatedMeasurements(surface=surface, measurements=found, frame=frame_of(true, boundaries))


def frame_of(true: TrueVisit, boundaries: tuple[Boundary, ...] | None = None) -> np.ndarray:
    """Frame (rows: patient's left, up, ahead) as upright cameras would give it."""
    left, right = boundaries or true.torso.boundaries
    ahead = frame_from_sides(left.points_world, right.points_world, seen_skin(true.torso.surface))[2]
    ahead = ahead - _UPRIGHT * (ahead @ _UPRIGHT)
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(_UPRIGHT, ahead), _UPRIGHT, ahead])


def rows(count: int, first: int = 1, settings: MeasureSettings = MeasureSettings()) -> Iterator[tuple[Row, Change]]:
    """Changes of all breasts: unchanged and changed, in the same pose and in another."""
    for number in range(first, first + count):
        rng = np.random.default_rng([number, 21])
        name = f"torso_{number}"
        shape = torso_shape(name, 0)
        before = true_visit(shape, name, number)
        measured = as_measured(before, settings, rng)
        for pairing in POSES:
            later = shape if pairing == "same pose" else otherwise(shape, rng)
            changed = rng.choice(SIDES)  # the other one stays as it was
            factors = {changed: float(np.exp(_GROWTH * rng.normal()))}
            place = number if pairing == "same pose" else 1000 + number
            try:
                after = true_visit(grown(later, factors), name, place)
            except ValueError:  # measures that do not fit together
                continue
            found = compare(measured, as_measured(after, settings, rng), common_scale=False)
            for breast in found.breasts:
                true_cc = after.volume_cc(breast.name) - before.volume_cc(breast.name)
                low, high = breast.volume.difference_interval_cc or (math.nan, math.nan)
                row = Row(
                    pairing=pairing,
                    true_cc=0.0 if breast.name != changed and abs(true_cc) < 1.0 else true_cc,
                    error_cc=breast.volume.difference_cc - true_cc,
                    half_cc=(high - low) / 2,
                    volumes_half_cc=(_half_cc(breast.before), _half_cc(breast.after)),
                    beyond=bool(breast.volume.beyond_error),
                    wall_mm=_wall_mm(before, after, breast.name, true_cc, settings),
                )
                yield row, found


def _half_cc(measured: VolumeMeasurement) -> float:
    return math.nan if measured.interval_cc is None else measured.interval_cc[1] - measured.volume_cc


def _wall_mm(before: TrueVisit, after: TrueVisit, side: str, true_cc: float, settings: MeasureSettings) -> float:
    """Error that the walls of both dates do not share, on true skin and boundaries, mm."""
    volumes: list[float] = []
    areas: list[float] = []
    for visit in (before, after):
        torso_ = visit.torso
        breasts = open_breasts(torso_.boundaries, torso_.surface, settings)
        wall = fit(next(each for each in breasts if each.boundary.name == side))
        volumes.append(wall.closed.volume_mm3() / 1000)
        areas.append(wall.mesh.area_mm2() / 100)
    return float(10 * abs(volumes[1] - volumes[0] - true_cc) / (np.hypot(areas[0], areas[1]) / np.sqrt(2)))


def trunk_fits(count: int) -> Iterator[tuple[str, TrunkFit | None]]:
    """Fits of trunks of other bodies, and of one body in very different poses. None: no fit."""
    trunks = {}
    for number in range(1, count + 1):
        name = f"torso_{number}"
        shape = torso_shape(name, 0)
        trunks[number] = _trunk(true_visit(shape, name, number))
        for sign in (-1.0, 1.0):
            try:
                other = true_visit(posed(shape, 12 * sign, (20 * sign, 15 * sign), 0.03 * sign), name, 500 + number)
            except ValueError:
                continue
            yield "one body, extreme poses", fit_trunks(trunks[number], _trunk(other))
    for one in trunks:
        for two in trunks:
            if one < two:
                try:
                    yield "two bodies", fit_trunks(trunks[one], trunks[two])
                except MeasureError:
                    yield "two bodies", None


def _trunk(true: TrueVisit) -> TrunkSkin:
    boundaries = [boundary.points_world for boundary in true.torso.boundaries]
    return trunk_of(true.torso.surface, boundaries, frame_of(true))


def summary(found: list[Row]) -> Iterator[str]:
    """Lines of the table, one per pairing with rows."""
    if not found:
        return
    columns = (
        *("dates", "breasts", "SD of the error cc", "half width cc", "held", "unchanged called changed"),
        *("changed and found: by more than the half width; all", "wall, 95 % mm"),
        *("RMS error / half width", "half width over the mean of both volumes'", "less than either volume's"),
    )
    yield f"| {' | '.join(columns)} |\n{'| --- ' * len(columns)}|"
    for pairing in POSES:
        group = [row for row in found if row.pairing == pairing]
        if not group:
            continue
        still = [row for row in group if row.true_cc == 0.0]
        moved = [row for row in group if row.true_cc != 0.0]
        beyond = [row for row in moved if abs(row.true_cc) > row.half_cc]
        yield (
            f"| {pairing} | {len(group)} | {np.std([row.error_cc for row in group], ddof=1):.1f} | "
            f"{np.median([row.half_cc for row in group]):.0f} | "
            f"{100 * np.mean([abs(row.error_cc) <= row.half_cc for row in group]):.1f} % | "
            f"{sum(row.beyond for row in still)} of {len(still)} | "
            f"{sum(row.beyond for row in beyond)} of {len(beyond)}; "
            f"{sum(row.beyond for row in moved)} of {len(moved)} | "
            f"{np.quantile([row.wall_mm for row in group], 0.95):.2f} | "
            f"{np.sqrt(np.mean([(row.error_cc / row.half_cc) ** 2 for row in group])):.2f} | "
            f"{np.median([row.half_cc / np.mean(row.volumes_half_cc) for row in group]):.2f} | "
            f"{sum(row.half_cc < min(row.volumes_half_cc) for row in group)} of {len(group)} |"
        )


def trunk_summary(fits: list[tuple[str, TrunkFit | None]], settings: CompareSettings) -> Iterator[str]:
    """Agreement of trunks, with numbers of warnings and refusals."""
    yield "| trunks | pairs | four fifths within mm: least, median, most | doubted | refused |\n" + "| --- " * 5 + "|"
    for kind in dict.fromkeys(kind for kind, _ in fits):
        within = np.array([math.inf if one is None else one.within_mm for each, one in fits if each == kind])
        yield (
            f"| {kind} | {len(within)} | {within.min():.2f}, {np.median(within):.2f}, {within.max():.2f} | "
            f"{np.sum((within > settings.doubt_mm) & (within <= settings.refuse_mm))} | "
            f"{np.sum(within > settings.refuse_mm)} |"
        )


def main() -> None:
    """Make the torsos, print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--torsos", type=int, default=24)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--bodies", type=int, default=12, help="whose trunks are laid onto one another")
    arguments = parser.parse_args()
    found = []
    for row, change in rows(arguments.torsos, arguments.first):
        found.append(row)
        print(
            f"{row.pairing} (taken as {change.pairing}): change {row.true_cc:+.1f} cc, off by {row.error_cc:+.1f}, "
            f"± {row.half_cc:.1f}, trunk within {change.fit.within_mm:.2f} mm, turned {change.fit.turned_deg:.1f}°",
            flush=True,
        )
    print("\n".join(summary(found)))
    print("\n".join(trunk_summary(list(trunk_fits(arguments.bodies)), CompareSettings())))


if __name__ == "__main__":
    main()
