"""Closed curve on the surface that separates a breast from the body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.progress import Progress, no_progress
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, Rig
from mammometry.matching.foreground.foreground import Foreground
from mammometry.measure.boundary import BoundaryRemark
from mammometry.measure.boundary.breasts import NoBreast, Outline, find_breasts
from mammometry.measure.boundary.cast_base import (
    BEND_GAIN,
    INLIER_MM,
    SECTORS,
    Base,
    fit_base,
    moved,
    no_rim,
    sectors_held,
    ways_to_bend,
)
from mammometry.measure.boundary.cast_rim import (
    SILHOUETTE_SIGMA_PX,
    AdjustedBase,
    RimCandidates,
    adjust_base,
    mean_height,
    require_separate,
    rim_candidates,
)
from mammometry.measure.boundary.protocol import outline_by_protocol
from mammometry.measure.boundary.trace import check_curve
from mammometry.measure.landmarks.landmarks import PICKED_SIGMA_MM, picked_landmarks
from mammometry.measure.settings import BaseRimSettings, MeasureSettings
from mammometry.measure.solid.cut import above
from mammometry.measure.trunk.body import rig_frame
from mammometry.measure.trunk.head import HeadPlace
from mammometry.surface.repair.repair import Provenance, RepairedSurface

RIM_RADIUS_SIGMA_MM = 0.14
"""Standard uncertainty of a rim's assumed radius, mm. Hand-made rims have 0 to 0.5."""
DRAWN_RIM_SIGMA_MM = 0.5
"""Standard uncertainty of a cast's base along its normal if its rim was drawn by hand, mm: about a rim's radius."""

BreastName = Literal["model", "left", "right"]
"""``model`` for a cast; the patient's own left and right for a torso."""
_HELD = 0.25  # weight from which a silhouette point counts as rim; not critical
_ALL_AROUND = 0.995  # share of a breast that is written as 100 %
_FLAT_MM = 0.1  # largest sag of a base that is called flat; not critical
_FOLDED = 0.5  # least creased share of the lower quarter for a visible fold; not critical
_SIGMA_QUANTILES = (0.1, 0.9)  # quantiles of a curve's uncertainty that are reported
_COARSE_PX = 1.0  # initial scatter, large: outliers are rejected gradually, local minima avoided; not critical
_BENDS = (0.15, 0.3, 0.45)  # curvatures that are tried: radius of the rim over that of the cylinder; not critical
_FINISHED = 3  # best fits with fixed curvature that are refined with free curvature; not critical
_UNSEEN_SHARE = 0.5  # distance of the visible rim in front of the base, relative to the rim's radius (decision 17)
_CUT_OFF = 5  # standard deviations to which distances from the common rim are limited
_FEW = 250  # rim points used to compare directions of bending; chosen for speed
_AGREED_PX = 0.07  # RMS disagreement of the cameras below which no other base is searched for (docs/decisions/0017)
_RIVAL_GAIN = 2.0
"""Plane and cylinder both remain possible if their mean squared disagreements (px²) differ by less than this factor.
Half of the distance between them then adds to the uncertainty. Not critical."""
_CUT_SHARE = 0.01  # share of the measured surface that a base may cut off in addition to the best (decision 17)


@value(eq=False)
class Boundary:
    """A closed curve on the surface around one breast.

    Raises:
        ValueError: fewer than three points, or a point that is not finite.
    """

    name: BreastName
    """``model``, or the patient's ``left`` or ``right``."""
    points_world: Float64[Array, "n 3"]
    """Corners of the closed curve in order, the first not repeated, mm, world frame."""
    method: str
    """How it was found, and under what assumptions."""
    evidence_world: Float64[Array, "k 3"] = field(default_factory=lambda: np.empty((0, 3)))
    """Points in the photographs that a cast's curve follows, mm, world frame; for figures."""
    sigma_mm: float | None = None
    """Standard uncertainty of the whole curve along the wall's normal, mm. None if unknown."""
    across_mm: Float64[Array, " n"] | None = None
    """Standard uncertainty of each point across a torso's curve, in addition to that of every drawn curve, mm: large
    where the skin does not show the border. None: zero."""
    hidden_fold_cm2: float = 0.0
    """Area of skin that closes a scan's hole at the fold, cm². 0: the fold is visible."""
    remarks: tuple[BoundaryRemark, ...] = ()
    """Facts about it, as codes."""

    def __post_init__(self) -> None:
        if len(self.points_world) < 3 or not np.isfinite(self.points_world).all():
            raise ValueError(f"boundary {self.name} needs three or more finite points, found {len(self.points_world)}")


def find_boundaries(
    surface: RepairedSurface,
    foregrounds: Mapping[str, Foreground],
    rig: Rig,
    subject_kind: Literal["model", "torso", "surface"],
    settings: MeasureSettings = MeasureSettings(),
    *,
    rim_radius_mm: float | None = None,
    progress: Progress = no_progress,
) -> tuple[Boundary, ...]:
    """Boundary of a cast, or boundaries of a torso's breasts. None for an open surface.

    Args:
        surface: the closed, repaired mesh; world frame, mm.
        foregrounds: silhouettes by camera, in the original photographs.
        rig: the calibrated cameras.
        subject_kind: kind of the subject.
        settings: tolerances.
        rim_radius_mm: radius of a cast's rounded rim, mm; None if it was not measured.
        progress: called with the fraction done.

    Raises:
        MeasureError: too little of a rim is visible; the border of a breast cannot be found.
    """
    if subject_kind == "surface":
        return ()
    boundaries: tuple[Boundary, ...]
    if subject_kind == "model":
        boundaries = (_cast_boundary(surface, foregrounds, rig, rim_radius_mm, settings),)
    else:
        boundaries = outline_torso(surface, rig_frame(rig)).boundaries
    progress(1.0)
    return boundaries


def _cast_boundary(
    surface: RepairedSurface,
    foregrounds: Mapping[str, Foreground],
    rig: Rig,
    rim_radius_mm: float | None,
    settings: MeasureSettings,
) -> Boundary:
    """Intersection of a cast's base with the mesh."""
    require_separate(foregrounds)
    candidates = rim_candidates(surface, foregrounds, rig)
    measured = surface.provenance == Provenance.MEASURED
    seen = surface.mesh.vertices[measured] if measured.any() else surface.mesh.vertices
    viewer = -np.mean([camera.axis_world for camera in rig.cameras.values()], axis=0)
    adjusted, rivals = find_base(candidates, seen, viewer, settings.base_rim)
    rounded_mm = settings.base_rim.rim_radius_mm if rim_radius_mm is None else rim_radius_mm
    base = moved(adjusted.base, np.array([0.0, 0.0, -_UNSEEN_SHARE * rounded_mm]), 1.0)
    part = above(surface.mesh, base.height)
    if not part.loops:
        raise MeasureError(
            "base of the model",
            found="a base that does not cut the surface",
            expected="a surface that reaches the base on every side",
            remedy="Check the silhouettes in the previews: the cast must be whole and separate from its surroundings",
        )
    shape = "plane" if base.is_plane else f"convex cylinder of radius {1 / base.curvature_per_mm:.0f} mm"
    held = adjusted.weights > _HELD
    loop = part.mesh.vertices[part.loops[0]]
    height_mm = mean_height(adjusted.base, loop)
    doubt_mm = max((abs(mean_height(rival, loop) - height_mm) / 2 for rival in rivals), default=0.0)
    return Boundary(
        name="model",
        points_world=loop,
        method=(
            f"base rim: {int(held.sum())} of {len(held)} silhouette points, seen by "
            f"{len(np.unique(candidates.camera[held]))} cameras, agree on a {shape} within {adjusted.scale_px:.2f} px. "
            f"The radius of the rim is {'assumed' if rim_radius_mm is None else 'given'} as {rounded_mm:g} mm. "
            "The cast is assumed to end at its rim, and its back, which no camera sees, to continue the rim"
        ),
        evidence_world=candidates.points_world[held],
        sigma_mm=float(np.linalg.norm([adjusted.sigma_mm(loop), doubt_mm, _UNSEEN_SHARE * RIM_RADIUS_SIGMA_MM])),
    )


def find_base(
    candidates: RimCandidates,
    surface_points: Float64[Array, "m 3"],
    viewer_direction: Float64[Array, 3],
    settings: BaseRimSettings = BaseRimSettings(),
) -> tuple[AdjustedBase, tuple[Base, ...]]:
    """A cast's base (plane or convex cylinder) from its rim, and alternatives that remain possible.

    A robust search comes first, then an adjustment to all silhouettes. The cylinder is used if the cameras agree
    clearly better on its rim than on the plane's. A base that cuts off measured skin that the other one keeps is
    excluded.

    Args:
        candidates: silhouette points that may show the rim.
        surface_points: measured points of the cast, mm, world frame.
        viewer_direction: direction from the cast towards the cameras, approximately.
        settings: tolerances.

    Raises:
        MeasureError: too few candidates, or rim points in too few directions around the cast.
    """
    rough = fit_base(candidates.points_world, surface_points, viewer_direction, settings)
    plane = adjust_base(rough.plane, candidates, bend=False)
    cylinder = adjust_base(rough.cylinder, candidates, bend=True)
    tried: list[AdjustedBase] = []
    whole = leaving_whole([plane, cylinder], surface_points)
    if min(_disagreement(base, SILHOUETTE_SIGMA_PX) for base in whole) > _AGREED_PX**2:
        tried = _ways_to_fit(plane, rough.cylinder, candidates, surface_points)
        cylinder = adjust_base(tried[0].base, candidates, bend=True)
    best = min(plane.scale_px, cylinder.scale_px)
    flat, bent = (_disagreement(base, best) for base in (plane, cylinder))
    curved = cylinder.base.curvature_per_mm * cylinder.extent_mm**2 / 2 > _FLAT_MM
    chosen, other = (cylinder, plane) if curved and flat > BEND_GAIN * bent else (plane, cylinder)
    whole = leaving_whole([chosen, other], surface_points)
    chosen = whole[0]
    middle = np.median(surface_points, axis=0)
    sectors = sectors_held(candidates.points_world[chosen.weights > _HELD], middle, chosen.base)
    if sectors < settings.minimum_sectors:
        raise no_rim(f"rim points in {sectors} of {SECTORS} directions", settings)
    rivals = [
        base
        for base in tried
        if _disagreement(base, SILHOUETTE_SIGMA_PX) < BEND_GAIN * _disagreement(tried[0], SILHOUETTE_SIGMA_PX)
    ]
    if max(flat, bent) < _RIVAL_GAIN * min(flat, bent):
        rivals += whole
    return chosen, tuple(rival.base for rival in rivals)


def _ways_to_fit(
    plane: AdjustedBase, cylinder: Base, candidates: RimCandidates, surface_points: Float64[Array, "m 3"]
) -> list[AdjustedBase]:
    """Cylinders on which the cameras nearly agree, best first, fitted to a part of the candidates.

    If only part of the rim is visible, there are several. So the plane is bent in each direction in small steps, and
    adjusted each time. The best of these, and the given cylinder, are then adjusted with free curvature.
    """
    few = candidates.chosen(slice(None, None, max(1, len(candidates.points_world) // _FEW)))

    def adjusted(start: Base, *, bend: bool) -> AdjustedBase:
        return adjust_base(start, few, bend=bend, coarse_px=_COARSE_PX)

    def disagreement(base: AdjustedBase) -> float:
        return _disagreement(base, SILHOUETTE_SIGMA_PX)

    settled: list[AdjustedBase] = []
    for turned in ways_to_bend(plane.base):
        base = replace(plane.base, frame=turned)
        for share in _BENDS:
            settled.append(adjusted(replace(base, curvature_per_mm=share / plane.extent_mm), bend=False))
            base = settled[-1].base
    settled.sort(key=disagreement)
    tried = [adjusted(start, bend=True) for start in (cylinder, *(start.base for start in settled[:_FINISHED]))]
    return sorted(leaving_whole(tried, surface_points), key=disagreement)


def leaving_whole(tried: list[AdjustedBase], surface_points: Float64[Array, "m 3"]) -> list[AdjustedBase]:
    """Bases that cut off at most 1 % more of the measured surface (mm, world frame) than the best one."""
    below = [float((attempt.base.height(surface_points) < -INLIER_MM).mean()) for attempt in tried]
    return [attempt for attempt, cut in zip(tried, below, strict=True) if cut <= min(below) + _CUT_SHARE]


def _disagreement(base: AdjustedBase, scale_px: float) -> float:
    """Mean squared distance from the common rim, each limited to five standard deviations, px²."""
    return float(np.minimum(base.residuals_px**2, (_CUT_OFF * scale_px) ** 2).mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorsoSides:
    """Boundaries on the sides of a torso, and reasons for sides without one."""

    boundaries: tuple[Boundary, ...]
    """Boundary of each breast, the patient's left first."""
    absent: tuple[NoBreast, ...]
    """Sides without a breast, with the reasons."""


def outline_torso(surface: RepairedSurface, frame: Float64[Array, "3 3"], *, head_stated: bool = False) -> TorsoSides:
    """Boundaries of a torso's breasts, found automatically, and sides without a breast.

    Args:
        surface: the closed, repaired mesh; world frame, mm.
        frame: patient's left, head, straight ahead (rows), approximately.
        head_stated: whether the user stated the head's direction.

    Raises:
        MeasureError: see `find_breasts`.
    """
    breasts = find_breasts(surface, frame, head_stated=head_stated)
    names: tuple[Literal["left", "right"], ...] = ("left", "right")
    sides = {name: getattr(breasts, name) for name in names}
    return TorsoSides(
        boundaries=tuple(
            _creased(name, side, breasts.head) for name, side in sides.items() if isinstance(side, Outline)
        ),
        absent=tuple(side for side in sides.values() if isinstance(side, NoBreast)),
    )


def _creased(name: BreastName, outline: Outline, head: HeadPlace) -> Boundary:
    fold = (
        "The fold below the breast is not seen: the border runs along skin that closes a hole. "
        if outline.hidden_fold_cm2
        else ""
        if outline.folded > _FOLDED
        else "No fold is seen below the breast: its edge is where its curve runs out. "
    )
    elsewhere = "" if outline.creased > _ALL_AROUND else "; elsewhere the shape of real women's breasts decided"
    surest, vaguest = np.quantile(outline.sigma_mm, _SIGMA_QUANTILES)
    method = (
        "automatic: along the outer side of the crease between breast and trunk. The crease was found around "
        f"{100 * outline.creased:.0f} % of the breast{elsewhere}. The curve is known to "
        f"± {surest:.0f} to {vaguest:.0f} mm (standard uncertainty). "
        f"{100 * outline.seen:.0f} % of it lies on measured or bridged skin. "
        f"{fold}{head.words[:1].upper()}{head.words[1:]}"
    )
    return Boundary(
        name=name,
        points_world=outline.points_world,
        method=method,
        across_mm=outline.sigma_mm,
        hidden_fold_cm2=outline.hidden_fold_cm2,
        remarks=("to-be-confirmed",) if head.is_shown else ("head-not-shown", "to-be-confirmed"),
    )


def landmark_boundaries(
    picked: Mapping[str, Float64[Array, "_ 3"]],
    surface: RepairedSurface,
    frame: Float64[Array, "3 3"],
    settings: MeasureSettings = MeasureSettings(),
) -> tuple[Boundary, ...]:
    """Boundaries from picked landmarks, by the protocol of `protocol`, for each side that has them.

    Args:
        picked: landmark → its points, mm, world frame.
        surface: the repaired mesh.
        frame: patient's left, head, straight ahead (rows), approximately.
        settings: how landmarks are joined.

    Raises:
        MeasureError: landmarks are missing, off the surface, on the wrong side or not around a breast.
    """
    marks = picked_landmarks(picked, surface.mesh, frame, sigma_mm=PICKED_SIGMA_MM)
    outlines = outline_by_protocol(marks, surface, frame, settings.protocol_join)
    names: tuple[BreastName, ...] = ("left", "right")
    return tuple(
        Boundary(name=name, points_world=outlines[name].points_world, method=outlines[name].definition)
        for name in names
        if name in outlines
    )


def given_boundary(
    name: BreastName,
    points_world: Float64[Array, "n 3"],
    surface: RepairedSurface,
    *,
    rim_sigma_mm: float | None = None,
    how: str | None = None,
) -> Boundary:
    """Boundary from a drawn curve.

    Args:
        name: name of the breast.
        points_world: its corners, mm, world frame.
        surface: the repaired mesh.
        rim_sigma_mm: standard uncertainty of a cast's drawn rim along its wall's normal, mm.
        how: how it was drawn, if known.

    Raises:
        MeasureError: the curve is open or off the surface.
    """
    if len(points_world) < 3:
        raise MeasureError(
            f"boundary {name!r}",
            found=f"{len(points_world)} points",
            expected="a closed curve of three points or more",
            remedy="Draw the boundary all the way around",
        )
    check_curve(name, points_world, surface.mesh)
    return Boundary(
        name=name,
        points_world=points_world,
        method=f"given: {len(points_world)} points, {how or 'how they were drawn is not recorded'}",
        sigma_mm=rim_sigma_mm if name == "model" else None,
        remarks=("given",),
    )
