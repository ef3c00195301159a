"""Changes of the breasts between two dates, with their own intervals.

The dates are registered on the trunk without breasts and arms, which may have changed or moved. So the map shows the
change of the breasts and not of the pose. The fit also tests whether both trunks are of the same patient. Volumes are
compared as measured at each date, with the same kind of wall, whose error they share.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.normal import COVERAGE_95
from mammometry.base.progress import Progress, no_progress
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Transform
from mammometry.geometry.nearest import point_tree
from mammometry.measure.settings import CompareSettings
from mammometry.measure.shape.lengths import LinearMeasure
from mammometry.measure.shape.symmetry import rms_mm, signed_mm, trunk_skin
from mammometry.measure.trunk.mirror_plane import Registration, register
from mammometry.measure.trunk.thorax import HEIGHT_WINDOW_MM, WIDEST_DEG, Trunk, find_trunk, on_trunk, seen_skin
from mammometry.measure.volume.difference import Pairing, VolumeDifference, difference
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_FIXED = 60_000  # points of the earlier trunk; chosen for speed
_JUDGED = 20_000  # points of the later trunk whose distance is measured; chosen for speed
_STARTS_MM = (0.0, -25.0, 25.0)  # shifts along the trunk's axis, its least certain direction (decision 22)
_BEYOND_MM = 20.0  # later skin farther beyond the earlier one's edge is not compared; error 1.4 mm on a round trunk
_SHARE = 0.8  # quantile of the distances; their robust scatter does not tell bodies apart (decision 22)


@value(eq=False)
class TrunkSkin:
    """The part of a torso used for registration."""

    points_world: Float64[Array, "n 3"]
    """Visible vertices outside the breasts and the arms, mm, world frame."""
    normals_world: Float64[Array, "n 3"]
    """Their unit outward normals."""
    trunk: Trunk
    """Axis and frame of the trunk."""
    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead, approximately; world frame."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrunkFit:
    """Registration of the later date's trunk to the earlier one's."""

    before_from_after: Transform
    """Motion from the later date's world frame to the earlier one's."""
    scatter_mm: float
    """Robust standard deviation of the distances between both trunks along the normal, mm."""
    within_mm: float
    """Distance along the normal within which 80 % of the later trunk agree with the earlier one, mm."""
    weakest_mm: float
    """Standard uncertainty of the least certain motion (`mirror_plane.Registration.weakest_mm`), mm."""
    turned_deg: float
    """Difference of the trunk's lean: angle between the photographs' vertical at both dates, degrees."""


def trunk_of(
    surface: RepairedSurface, boundaries: Sequence[Float64[Array, "_ 3"]], frame: Float64[Array, "3 3"]
) -> TrunkSkin:
    """The trunk's skin of a torso, without breasts and arms.

    Args:
        surface: the whole torso, world frame, mm.
        boundaries: curves around the breasts.
        frame: rows: the patient's left, the head, straight ahead, approximately, from the photographs.

    Raises:
        MeasureError: no skin is visible at the patient's sides.
    """
    middle = np.mean([boundary.mean(axis=0) for boundary in boundaries], axis=0)
    trunk = find_trunk(seen_skin(surface), frame, height_of=middle)
    if trunk.assumed:
        raise MeasureError(
            "torso",
            found="no measured skin on one of the patient's sides",
            expected="skin beside the breasts, on which the two dates are registered",
            remedy="Add views from the sides",
        )
    points, normals = trunk_skin(surface, boundaries)
    flat = trunk.cylindrical(points)
    keep = on_trunk(flat, trunk) & (np.abs(flat[:, 1]) < HEIGHT_WINDOW_MM)
    keep &= np.abs(flat[:, 0]) < np.deg2rad(WIDEST_DEG) * trunk.half_width_mm
    return TrunkSkin(points_world=points[keep], normals_world=normals[keep], trunk=trunk, frame=frame)


def fit_trunks(before: TrunkSkin, after: TrunkSkin) -> TrunkFit:
    """Registration of the later trunk to the earlier one.

    It starts at several shifts along the axis, its least certain direction, with the axes aligned and, in case an axis
    is wrong, with the photographs' frames aligned.

    Raises:
        MeasureError: the trunks do not match from any start.
    """
    fixed = _every(before, _FIXED)
    found: list[tuple[float, Registration]] = []
    refused: list[MeasureError] = []
    turns = before.trunk.frame.T @ after.trunk.frame, before.frame.T @ after.frame
    for rotation, along_mm in product(turns, _STARTS_MM):
        origin = before.trunk.origin + along_mm * before.trunk.frame[1]
        start = Transform(rotation=rotation, translation_mm=origin - rotation @ after.trunk.origin)
        try:
            laid = register(
                (after.points_world, after.normals_world), fixed, start=start, subject="the trunks of both dates"
            )
        except MeasureError as error:
            refused.append(error)
        else:
            found.append((_within_mm(laid.fixed_from_moving, after, fixed), laid))
    if not found:
        raise refused[0]
    within_mm, best = min(found, key=lambda scored: scored[0])
    upright = best.fixed_from_moving.rotate(after.frame[1:2])[0]
    return TrunkFit(
        before_from_after=best.fixed_from_moving,
        scatter_mm=best.scatter_mm,
        within_mm=within_mm,
        weakest_mm=best.weakest_mm,
        turned_deg=float(np.rad2deg(np.arccos(np.clip(upright @ before.frame[1], -1.0, 1.0)))),
    )


def _within_mm(
    motion: Transform, after: TrunkSkin, fixed: tuple[Float64[Array, "m 3"], Float64[Array, "m 3"]]
) -> float:
    """Distance along the normal within which 80 % of the moved trunk agree, where both dates show it, mm."""
    moved = motion.apply(_every(after, _JUDGED)[0])
    fixed_points, outward = fixed
    nearest = np.asarray(point_tree(fixed_points).query(moved)[1])
    offset, normals = moved - fixed_points[nearest], outward[nearest]
    away = (offset * normals).sum(axis=1)
    shared = np.linalg.norm(offset - away[:, None] * normals, axis=1) < _BEYOND_MM
    return float(np.quantile(np.abs(away[shared]), _SHARE))


def _every(skin: TrunkSkin, at_most: int) -> tuple[Float64[Array, "m 3"], Float64[Array, "m 3"]]:
    chosen = slice(None, None, max(1, len(skin.points_world) // at_most))
    return skin.points_world[chosen], skin.normals_world[chosen]


SAME_POSE_MM = 0.8
"""Largest `within_mm` of one pose. Measured skin has 0.1 to 0.3 mm; arms and breathing add 1 mm."""
SAME_POSE_DEG = 4.0
"""Largest difference of lean in one pose, degrees: beyond it breasts hang differently."""
EARLIER, LATER = "before", "after"


@value(eq=False)
class DatedMeasurements:
    """The measurements of one date, in its own world frame, mm."""

    surface: RepairedSurface
    measurements: tuple[VolumeMeasurement, ...]
    """One for each breast."""
    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead, approximately, from the photographs."""
    lengths: tuple[LinearMeasure, ...] = ()
    """Lengths between landmarks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthChange:
    """One length at both dates, mm."""

    name: str
    """As `LinearMeasure.name`."""
    title: str
    """Its name in reports."""
    along: bool
    """Whether it is measured along the skin instead of straight."""
    before_mm: float
    after_mm: float
    sigma_mm: float
    """Standard uncertainty of the change, from the landmarks of both dates."""

    @property
    def change_mm(self) -> float:
        """After − before, mm."""
        return self.after_mm - self.before_mm

    @property
    def beyond_error(self) -> bool:
        """Whether the 95 % interval of the change excludes zero."""
        return abs(self.change_mm) > COVERAGE_95 * self.sigma_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BreastChange:
    """One breast at both dates."""

    name: str
    """The patient's ``left`` or ``right``."""
    before: VolumeMeasurement
    after: VolumeMeasurement
    volume: VolumeDifference
    """After − before, with its own interval."""
    rms_mm: float
    """RMS distance between the skin of both dates within the later boundary, mm."""


@value(eq=False)
class Change:
    """Changes between two dates."""

    fit: TrunkFit
    """Registration of the trunks, with its quality."""
    doubtful: bool
    """Whether the trunks may be of two patients (`CompareSettings.doubt_mm`)."""
    pairing: Pairing
    """``same pose`` or ``across poses``: it determines how much of the walls' errors is shared."""
    breasts: tuple[BreastChange, ...]
    lengths: tuple[LengthChange, ...]
    """Lengths that were measured at both dates."""
    after_mm: Float64[Array, " m"]
    """For each vertex of the later surface, signed distance in front of the earlier skin, mm. NaN if a date does not
    show it."""


def compare(
    before: DatedMeasurements,
    after: DatedMeasurements,
    settings: CompareSettings = CompareSettings(),
    *,
    common_scale: bool = True,
    progress: Progress = no_progress,
) -> Change:
    """Changes of volumes, lengths and skin between two dates.

    Args:
        before: the earlier date.
        after: the later date.
        settings: limits of the trunks' agreement.
        common_scale: whether both dates' scale depends on one measurement of the same target.
        progress: called with the fraction done.

    Raises:
        MeasureError: no breast has a volume at both dates, the walls differ in kind, or the trunks are of two bodies.
    """
    pairs = _paired(before, after)
    fit = _fit(before, after)
    pairing, doubtful = judged(fit, settings)
    progress(0.3)
    laid = after.surface.mesh.transformed(fit.before_from_after)
    seen_before = before.surface.mesh.faces_within(_seen(before.surface))
    seen_after = _seen(after.surface)
    after_mm = signed_mm(laid, before.surface.mesh.submesh(seen_before), selected=seen_after)
    progress(0.9)
    return Change(
        fit=fit,
        doubtful=doubtful,
        pairing=pairing,
        breasts=tuple(
            BreastChange(
                name=pair.name,
                before=pair,
                after=other,
                volume=difference(other, pair, pairing, names=(LATER, EARLIER), common_scale=common_scale),
                rms_mm=_rms_mm(other, after.surface, after_mm),
            )
            for pair, other in pairs
        ),
        lengths=tuple(length_changes(before.lengths, after.lengths)),
        after_mm=after_mm,
    )


def judged(fit: TrunkFit, settings: CompareSettings = CompareSettings()) -> tuple[Pairing, bool]:
    """Whether both dates show the same pose, and whether the match is doubtful.

    Raises:
        MeasureError: the trunks are of two bodies.
    """
    if fit.within_mm > settings.refuse_mm:
        raise MeasureError(
            "the trunks of both dates",
            found=f"a fifth of their skin more than {fit.within_mm:.1f} mm apart",
            expected=f"one body, within {settings.refuse_mm:g} mm beside the breasts",
            remedy="Check that both show the same patient in about the same pose, with arms and breathing alike; "
            "compare.refuse_mm sets the limit",
        )
    same = fit.within_mm <= SAME_POSE_MM and fit.turned_deg <= SAME_POSE_DEG
    pairing: Pairing = "same pose" if same else "across poses"
    return pairing, fit.within_mm > settings.doubt_mm


def length_changes(before: Sequence[LinearMeasure], after: Sequence[LinearMeasure]) -> list[LengthChange]:
    """Changes of the lengths that both dates have, straight and along the skin."""
    earlier = {measurement.name: measurement for measurement in before}
    found = []
    for later in after:
        earlier_one = earlier.get(later.name)
        if earlier_one is None or earlier_one.title != later.title:  # one midline was picked, the other computed
            continue
        found.append(
            LengthChange(
                name=later.name,
                title=later.title,
                along=False,
                before_mm=earlier_one.straight_mm,
                after_mm=later.straight_mm,
                sigma_mm=float(np.hypot(earlier_one.straight_sigma_mm, later.straight_sigma_mm)),
            )
        )
        sigmas = earlier_one.geodesic_sigma_mm, later.geodesic_sigma_mm
        if earlier_one.geodesic_mm is not None and later.geodesic_mm is not None and None not in sigmas:
            found.append(
                LengthChange(
                    name=later.name,
                    title=later.title,
                    along=True,
                    before_mm=earlier_one.geodesic_mm,
                    after_mm=later.geodesic_mm,
                    sigma_mm=float(np.hypot(*sigmas)),  # type: ignore[arg-type]  # neither is None
                )
            )
    return found


def _paired(before: DatedMeasurements, after: DatedMeasurements) -> list[tuple[VolumeMeasurement, VolumeMeasurement]]:
    """Measurements of each breast at both dates.

    Raises:
        MeasureError: there are none, or their walls differ in kind.
    """
    earlier, later = (
        {measurement.name: measurement for measurement in visit.measurements} for visit in (before, after)
    )
    if not earlier.keys() & later.keys() or "model" in earlier:
        raise MeasureError(
            "the breasts of both dates",
            found=f"{_listed(earlier)} before, {_listed(later)} after",
            expected="a breast of a torso at both dates",
            remedy="Draw the missing boundary with `mammometry edit`, or remove the additional one at the other date",
        )
    earlier = {name: earlier_measurement for name, earlier_measurement in earlier.items() if name in later}
    for name, earlier_measurement in earlier.items():
        if earlier_measurement.wall_kind != later[name].wall_kind:
            raise MeasureError(
                f"the chest wall of the {name} breast",
                found=f"{earlier_measurement.wall_kind} before, {later[name].wall_kind} after",
                expected="the same kind at both dates",
                remedy="Measure both with the same --set measure.wall",
            )
    return [(earlier[name], later[name]) for name in earlier]


def _listed(names: Iterable[str]) -> str:
    return " and ".join(names) or "none"


def _fit(before: DatedMeasurements, after: DatedMeasurements) -> TrunkFit:
    """Registration of the trunks without the breasts of either date."""
    curves = [
        {measurement.name: measurement.boundary_world for measurement in visit.measurements}
        for visit in (before, after)
    ]
    fit = fit_trunks(
        trunk_of(before.surface, list(curves[0].values()), before.frame),
        trunk_of(after.surface, list(curves[1].values()), after.frame),
    )
    motion = fit.before_from_after
    gone = {name: motion.inverse().apply(curve) for name, curve in curves[0].items() if name not in curves[1]}
    new = {name: motion.apply(curve) for name, curve in curves[1].items() if name not in curves[0]}
    if not gone and not new:
        return fit
    return fit_trunks(
        trunk_of(before.surface, [*curves[0].values(), *new.values()], before.frame),
        trunk_of(after.surface, [*curves[1].values(), *gone.values()], after.frame),
    )


def _seen(surface: RepairedSurface) -> Bool[Array, " n"]:
    """Vertices that are not invented, nor, on a scan, completed at a hidden fold."""
    seen = surface.provenance != Provenance.INVENTED
    return seen if surface.pair_names else seen & (surface.provenance != Provenance.BRIDGED)


def _rms_mm(measured: VolumeMeasurement, surface: RepairedSurface, out_mm: Float64[Array, " m"]) -> float:
    """RMS of a map of a surface over the part of it that is one breast."""
    skin = measured.skin
    return rms_mm(skin, out_mm[np.asarray(point_tree(surface.mesh.vertices).query(skin.vertices)[1])])
