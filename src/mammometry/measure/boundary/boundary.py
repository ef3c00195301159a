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
"""Standard uncertainty of that radius, mm. Hand-made rims may have anything from 0 to .5."""
DRAWN_RIM_SIGMA_MM = 0.5
"""Standard uncertainty of a cast's base along its normal if its rim was drawn by hand, mm. A rim is rounded by about
as much, and a hand that follows it errs to both sides.
"""

BreastName = Literal["model", "left", "right"]
"""A cast is "model". A torso has the patient's own left and right breast."""
_HELD = 0.25  # weight from which a silhouette point counts as rim; chosen by eye
_ALL_AROUND = 0.995  # share of a breast that is written as 100 %
_FLAT_MM = 0.1  # a base that sags less than this towards its rim is called flat; chosen by eye
_FOLDED = 0.5  # share of the lower quarter that must be creased for a fold to be seen there; chosen by eye
_SURE_TO_VAGUE = (0.1, 0.9)  # quantiles of a curve's uncertainty that are said
_COARSE_PX = 1.0  # outliers are left out little by little, else the nearest of several minima is found; chosen by eye
_BENDS = (0.15, 0.3, 0.45)  # curvatures tried, as the rim's radius over the cylinder's; chosen by eye
_FINISHED = 3  # of the ways of bending that settled, as many bend freely; chosen by eye
_UNSEEN_SHARE = 0.5  # of a rounded rim's radius by which the base that is seen lies before the true one (decision 17)
_CUT_OFF = 5  # standard deviations above which a distance from the common rim counts no more
_FEW = 250  # rim points that tell one way of bending from another; chosen for speed
_AGREED_PX = 0.07  # RMS to which the cameras agree on a base for no other to be looked for (docs/decisions/0017)
_RIVAL_GAIN = 2.0
"""Plane and cylinder are both possible if their mean squared disagreements (px²) differ by a smaller factor. Then half
of what lies between them is uncertain. Chosen by eye."""
_CUT_SHARE = 0.01  # a base that cuts off this much more of the measured surface than another is none (decision 17)


@value(eq=False)
class Boundary:
    """A closed curve on the surface around one breast.

    Raises:
        ValueError: fewer than three points, or a point that is not finite.
    """

    name: BreastName
    """"model", or the patient's "left" or "right"."""
    points_world: Float64[Array, "n 3"]
    """Ordered corners of the curve, mm, world frame. The last joins the first, which is not repeated."""
    method: str
    """How it was found and what that assumes, one sentence."""
    evidence_world: Float64[Array, "k 3"] = field(default_factory=lambda: np.empty((0, 3)))
    """Points seen in the photographs that the curve follows (a cast's rim), mm, world frame. For figures."""
    sigma_mm: float | None = None
    """Standard uncertainty of the whole curve along the wall's normal, mm. None if not known."""
    across_mm: Float64[Array, " n"] | None = None
    """Standard uncertainty of each point across a torso's curve beyond what any drawn curve has, mm: how little the
    skin shows of the border there. None: nothing beyond."""
    hidden_fold_cm2: float = 0.0
    """Area of skin that closes a scan's hole where the fold is, cm². 0: the fold is seen."""
    remarks: tuple[BoundaryRemark, ...] = ()
    """Facts by which programs decide."""

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
    """Find the boundary of a cast, or of a torso's two breasts. An open surface has none.

    Args:
        surface: the closed, repaired mesh; world frame, mm.
        foregrounds: silhouettes by camera, in the original photographs.
        rig: the calibrated cameras.
        subject_kind: what stands before the cameras.
        settings: tolerances.
        rim_radius_mm: radius by which a cast's rim is rounded, mm; None if it was not measured.
        progress: called with the fraction done.

    Raises:
        MeasureError: no rim, or too little of it; a breast whose border cannot be found.
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
    """The curve in which a cast's base cuts the mesh."""
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
            expected="a surface that reaches down to the base on every side",
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
    """Find a cast's base from its rim: plane or convex cylinder.

    It is searched robustly, then adjusted to all silhouettes. The cylinder is taken if the cameras agree on its rim
    clearly better than on the plane's. Neither is taken if it cuts off measured skin that the other leaves.

    Args:
        candidates: silhouette points that may show the rim.
        surface_points: measured points of the cast, mm, world frame.
        viewer_direction: from the cast towards the cameras, roughly.
        settings: tolerances.

    Returns:
        The base, and others that the cameras do not rule out.

    Raises:
        MeasureError: too few candidates, or too few directions around the cast that hold rim points.
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
    """Cylinders on which the cameras nearly agree, the best first.

    Only some of the candidates are used. A rim that is seen in part has several. So the plane is bent in every
    direction, little by little, and settles each time. The best of these, and the cylinder found before, then bend
    freely.
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
    """Bases that cut off no more measured surface than the best one. The surface is in mm, world frame."""
    below = [float((attempt.base.height(surface_points) < -INLIER_MM).mean()) for attempt in tried]
    return [attempt for attempt, cut in zip(tried, below, strict=True) if cut <= min(below) + _CUT_SHARE]


def _disagreement(base: AdjustedBase, scale_px: float) -> float:
    """Mean squared distance from the common rim, px².

    Each distance is limited to five standard deviations.
    """
    return float(np.minimum(base.residuals_px**2, (_CUT_OFF * scale_px) ** 2).mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorsoSides:
    """Boundaries found on either side of a torso, or reasons why there is none."""

    boundaries: tuple[Boundary, ...]
    """Of each breast, the patient's left first."""
    absent: tuple[NoBreast, ...]
    """Sides without a breast, and what that rests on."""


def outline_torso(surface: RepairedSurface, frame: Float64[Array, "3 3"], *, head_stated: bool = False) -> TorsoSides:
    """Outline the breast of each side, or say that there is none.

    Args:
        surface: the closed, repaired mesh; world frame, mm.
        frame: patient's left, head, straight ahead (rows), roughly.
        head_stated: whether the user said where the head is.

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
    surest, vaguest = np.quantile(outline.sigma_mm, _SURE_TO_VAGUE)
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
    """Boundaries by the named protocol for every side with picked landmarks.

    `protocol` defines it.

    Args:
        picked: landmark → its points, mm, world frame.
        surface: the repaired mesh.
        frame: patient's left, head, straight ahead (rows), roughly.
        settings: how they are joined.

    Raises:
        MeasureError: landmarks are missing, lie off the surface, on the wrong side or not around a breast.
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
    """Use a drawn curve as the boundary. Landmarks in order around the breast serve as well.

    Args:
        name: name of the breast.
        points_world: its corners, mm, world frame.
        surface: the repaired mesh.
        rim_sigma_mm: standard uncertainty of a cast's drawn rim along its wall's normal, mm.
        how: how it was drawn, in words, where that is known.

    Raises:
        MeasureError: the curve is open or lies off the surface.
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
