"""Measures of a breast other than its volume: landmarks, base, distribution, lengths, ptosis.

Volumes on one side of a plane are exact for the mesh. By the divergence theorem a solid's volume is the sum of the
tetrahedra that its faces form with any origin. With the origin on the cutting planes, the cut faces contribute nothing,
so no caps are built.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, TriangleMesh, UInt8
from mammometry.geometry.nearest import closest_on_mesh, point_tree
from mammometry.measure.boundary.boundary import Boundary, BreastName
from mammometry.measure.landmarks.landmarks import PICKED_SIGMA_MM, Landmark, picked_landmarks
from mammometry.measure.landmarks.nipple import propose_nipple
from mammometry.measure.landmarks.proposals import EndSigmas, propose_ends, propose_on_midline
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.shape.lengths import LinearMeasure, Ptosis, by_name, linear_measures, ptosis
from mammometry.measure.trunk.body import BodyDirections
from mammometry.measure.trunk.mirror_plane import MirrorPlane
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.surface.repair.repair import RepairedSurface


def volume_within_mm3(solid: TriangleMesh, origin: Float64[Array, 3], normals: Sequence[Float64[Array, 3]]) -> float:
    """Volume of the part of a closed solid on the positive side of planes through one point, mm³.

    Args:
        solid: closed, mm.
        origin: a point on all planes, mm.
        normals: normals of one or more planes, towards the positive side.
    """
    triangles = solid.corners() - origin
    for normal in normals:
        triangles = _clipped(triangles, normal)
    a, b, c = np.moveaxis(triangles, 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _clipped(triangles: Float64[Array, "m 3 3"], normal: Float64[Array, 3]) -> Float64[Array, "k 3 3"]:
    """Triangles clipped to the positive side of the plane through the origin, orientation kept."""
    height = triangles @ normal
    inside = height >= 0
    count = inside.sum(axis=1)
    a, b, c, up = _odd_first(triangles, height, inside, count == 1)
    ab, ac = _crossing(a, b, up[:, 0], up[:, 1]), _crossing(a, c, up[:, 0], up[:, 2])
    d, e, f, down = _odd_first(triangles, height, ~inside, count == 2)
    ed, fd = _crossing(e, d, down[:, 1], down[:, 0]), _crossing(f, d, down[:, 2], down[:, 0])
    parts = [
        triangles[count == 3],
        np.stack([a, ab, ac], axis=1),
        np.stack([ed, e, f], axis=1),
        np.stack([ed, f, fd], axis=1),
    ]
    return np.concatenate(parts)


def _odd_first(
    triangles: Float64[Array, "m 3 3"],
    height: Float64[Array, "m 3"],
    odd: Bool[Array, "m 3"],
    chosen: Bool[Array, " m"],
) -> tuple[Float64[Array, "k 3"], Float64[Array, "k 3"], Float64[Array, "k 3"], Float64[Array, "k 3"]]:
    """Corners of the triangles, the odd one first, and their heights."""
    order = (np.argmax(odd[chosen], axis=1)[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles[chosen], order[..., None], axis=1)
    return corners[:, 0], corners[:, 1], corners[:, 2], np.take_along_axis(height[chosen], order, axis=1)


def _crossing(
    above: Float64[Array, "k 3"], below: Float64[Array, "k 3"], high: Float64[Array, " k"], low: Float64[Array, " k"]
) -> Float64[Array, "k 3"]:
    return above + (below - above) * (high / (high - low))[:, None]


@value
class BreastShape:
    """Extent of one breast and distribution of its volume, in the body frame."""

    name: BreastName
    """``model``, or the patient's ``left`` or ``right``."""
    skin_cm2: float
    """Area of the skin within the boundary, cm²."""
    base_width_mm: float
    """Extent of the boundary from side to side, mm."""
    base_height_mm: float
    """Extent of the boundary from its lowest to its highest point, mm."""
    base_sigma_mm: float
    """Standard uncertainty of base width and height, from that of the boundary, mm."""
    projection_mm: float
    """Greatest distance of the skin from the boundary's best plane, mm."""
    projection_sigma_mm: float
    """Standard uncertainty of the projection, from that of the boundary, mm."""
    quadrants_cc: Mapping[str, float]
    """Volume of each quadrant about the nipple, cc: upper or lower, medial or lateral (of a model: left or right, as of
    a patient who faces the cameras). Their sum is the volume. Empty without a nipple."""
    above_nipple_cc: float | None
    """Upper pole: volume above the level of the nipple, cc."""
    below_nipple_cc: float | None
    """Lower pole: volume below the level of the nipple, cc."""
    pole_sigma_cc: float | None
    """Standard uncertainty of either pole, from that of the nipple's height, cc."""


def shape_of(
    measured: VolumeMeasurement, frame: Float64[Array, "3 3"], nipple: Landmark | None, *, boundary_sigma_mm: float
) -> BreastShape:
    """Shape of one breast.

    Args:
        measured: the closed solid and its boundary.
        frame: rows: the patient's left, the head, straight ahead; world frame.
        nipple: the quadrants' common corner; None: no quadrants.
        boundary_sigma_mm: standard uncertainty of the boundary curve, mm.
    """
    extent = np.ptp(measured.boundary_world @ frame.T, axis=0)
    quadrants: dict[str, float] = {}
    above = below = sigma = None
    if nipple is not None:
        place, left, up = nipple.points_world[0], frame[0], frame[1]
        sides = {"model": ("left", "right"), "left": ("lateral", "medial"), "right": ("medial", "lateral")}
        for level, upwards in (("upper", up), ("lower", -up)):
            for side, sideways in zip(sides[measured.name], (left, -left), strict=True):
                quadrants[f"{level} {side}"] = _cc(measured, place, upwards, sideways)
        above, below = _cc(measured, place, up), _cc(measured, place, -up)
        step = up * nipple.sigma_mm
        sigma = abs(_cc(measured, place - step, up) - _cc(measured, place + step, up)) / 2
    return BreastShape(
        name=measured.name,
        skin_cm2=measured.area_cm2,
        base_width_mm=float(extent[0]),
        base_height_mm=float(extent[1]),
        base_sigma_mm=float(np.sqrt(2.0) * boundary_sigma_mm),
        projection_mm=measured.projection_mm,
        projection_sigma_mm=_projection_sigma_mm(measured, boundary_sigma_mm),
        quadrants_cc=quadrants,
        above_nipple_cc=above,
        below_nipple_cc=below,
        pole_sigma_cc=sigma,
    )


def _projection_sigma_mm(measured: VolumeMeasurement, boundary_sigma_mm: float) -> float:
    """Shift of the boundary's best plane when all of it moves outwards on the skin by one sigma, mm.

    Errors along the curve are taken as fully correlated: an observer who draws wider does so all around.
    """
    points, skin = measured.boundary_world, measured.skin
    plane_normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    skin_normals = skin.vertex_normals()[point_tree(skin.vertices).query(points)[1]]
    along = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    outward = np.cross(along, skin_normals)
    length = np.linalg.norm(outward, axis=1)
    rise = np.divide(outward @ plane_normal, length, out=np.zeros_like(length), where=length > 0)  # 0: no direction
    return float(abs(np.average(rise, weights=np.linalg.norm(along, axis=1))) * boundary_sigma_mm)


def _cc(measured: VolumeMeasurement, place: Float64[Array, 3], *normals: Float64[Array, 3]) -> float:
    return volume_within_mm3(measured.closed, place, normals) / 1000


@value(eq=False)
class Dimensions:
    """Shape, lengths and ptosis of all breasts of one subject."""

    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead; world frame."""
    shapes: tuple[BreastShape, ...]
    lengths: tuple[LinearMeasure, ...]
    ptosis: tuple[Ptosis, ...]


def find_landmarks(
    surface: RepairedSurface,
    colours: UInt8[Array, "n 3"],
    measurements: Sequence[VolumeMeasurement],
    picked: Mapping[str, Float64[Array, "k 3"]],
    body: BodyDirections | None,
    settings: MeasureSettings = MeasureSettings(),
    *,
    boundaries: Sequence[Boundary] = (),
) -> tuple[Landmark, ...]:
    """Picked landmarks, and proposals for those that were not picked.

    Nipples, the ends of the boundaries and landmarks on the mid-sagittal plane are proposed. No nipple, notch or
    umbilicus is proposed on unmeasured skin.

    Args:
        surface: the whole surface, mm, world frame.
        colours: colour of each vertex, sRGB.
        measurements: one for each breast.
        picked: landmark → its points, mm.
        body: the body frame; None: of a cast. Without a mid-sagittal plane nothing on the midline is proposed.
        settings: uncertainty of a drawn boundary.
        boundaries: boundaries of the breasts, with the uncertainty of their points.

    Raises:
        MeasureError: a picked landmark is off the surface or on the wrong side.
    """
    middles = [measured.boundary_world.mean(axis=0) for measured in measurements if measured.name != "model"]
    middle = np.mean(middles, axis=0) if len(middles) == 2 else None
    frame = None if body is None else body.frame
    mesh = surface.mesh
    found = list(picked_landmarks(picked, mesh, frame, sigma_mm=PICKED_SIGMA_MM, middle_world=middle))
    tree = point_tree(mesh.vertices)
    for measured in measurements:
        name = f"nipple_{measured.name}"
        if name in picked:
            continue
        skin = measured.skin
        nearest = tree.query(skin.vertices)[1]
        proposal = propose_nipple(name, skin, colours[nearest], measured.boundary_world)
        if proposal is not None:
            place = closest_on_mesh(proposal.points_world, mesh).points
            if surface.claimed[tree.query(place)[1]].all():
                found.append(replace(proposal, points_world=place))
    if body is not None:
        proposed = _of_torso(surface, measurements, body, settings, boundaries)
        found += [mark for mark in proposed if mark.name not in picked]
    return tuple(found)


def _of_torso(
    surface: RepairedSurface,
    measurements: Sequence[VolumeMeasurement],
    body: BodyDirections,
    settings: MeasureSettings,
    boundaries: Sequence[Boundary],
) -> Iterator[Landmark]:
    """Yield proposals for the ends of the breasts and the landmarks on the midline."""
    frame, plane = body.frame, body.plane
    scatter = settings.observers
    curves = {
        measurement.name: measurement.boundary_world for measurement in measurements if measurement.name != "model"
    }
    for side, curve in curves.items():
        across = next((boundary.across_mm for boundary in boundaries if boundary.name == side), None)
        sigmas = EndSigmas(
            lower_mm=scatter.lower_mm, medial_mm=scatter.medial_mm, lateral_mm=scatter.lateral_mm, across_mm=across
        )
        hidden = any(boundary.hidden_fold_cm2 for boundary in boundaries if boundary.name == side)
        for mark in propose_ends(side, curve, frame, sigmas):
            if not (hidden and mark.name == f"inframammary_fold_{side}"):
                yield mark
    if plane is not None and curves:
        heights = (np.concatenate(list(curves.values())) - plane.point_world) @ frame[1]
        lowest, highest = float(heights.min()), float(heights.max())
        yield from propose_on_midline(
            surface.mesh, frame, plane.point_world, plane.sigma_mm, lowest, highest, claimed=surface.claimed
        )


def dimensions(
    mesh: TriangleMesh,
    measurements: Sequence[VolumeMeasurement],
    landmarks: Sequence[Landmark],
    frame: Float64[Array, "3 3"],
    settings: MeasureSettings = MeasureSettings(),
    *,
    plane: MirrorPlane | None = None,
    hidden_folds: Collection[str] = (),
) -> Dimensions:
    """Shape, lengths and ptosis of all breasts.

    Args:
        mesh: the whole surface, mm, world frame.
        measurements: one for each breast.
        landmarks: landmarks on this surface; improbable ones are ignored.
        frame: rows: the patient's left, the head, straight ahead; world frame.
        settings: uncertainty of the boundary.
        plane: the mid-sagittal plane, used if no midline was picked.
        hidden_folds: breasts whose fold is not visible; their ptosis is measured only from a picked fold.

    Raises:
        MeasureError: the surface does not connect two landmarks.
    """
    named = by_name([mark for mark in landmarks if mark.probability >= settings.nipple.least_probability])
    sigma = settings.observers.mean_mm
    midline = None if plane is None else (plane.point_world, plane.normal_world, plane.sigma_mm)
    sagging = [
        ptosis(
            measured,
            frame[1],
            named[f"nipple_{measured.name}"],
            _picked(named.get(f"inframammary_fold_{measured.name}")),
            boundary_sigma_mm=sigma,
        )
        for measured in measurements
        if measured.name != "model"
        and f"nipple_{measured.name}" in named
        and (measured.name not in hidden_folds or _picked(named.get(f"inframammary_fold_{measured.name}")))
    ]
    return Dimensions(
        frame=frame,
        shapes=tuple(
            shape_of(measured, frame, named.get(f"nipple_{measured.name}"), boundary_sigma_mm=sigma)
            for measured in measurements
        ),
        lengths=linear_measures(named, mesh, midline=midline),
        ptosis=tuple(sagging),
    )


def _picked(landmark: Landmark | None) -> Landmark | None:
    """A picked landmark, or None: the boundary's own lowest point is more certain than a proposal."""
    return None if landmark is None or landmark.proposed else landmark
