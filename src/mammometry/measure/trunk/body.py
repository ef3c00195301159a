"""The body frame: axis, mid-sagittal plane, direction of the head.

It is found once, from the trunk, and used everywhere: for the search for breasts, walls, quadrants, ptosis, comparisons
and views. The cameras give the head's direction only approximately; it is tested against the body itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float64, Rig
from mammometry.measure.trunk.mirror_plane import MirrorPlane, mirror_plane
from mammometry.measure.trunk.thorax import (
    HEIGHT_WINDOW_MM,
    TRUNK_SAMPLES,
    WIDEST_DEG,
    SkinSamples,
    Trunk,
    find_trunk,
    level_axis,
    on_trunk,
    orthonormal,
    seen_skin,
)
from mammometry.surface.repair.repair import RepairedSurface

Mounting: TypeAlias = Literal["upright", "upside-down", "left", "right"]
"""Direction of a camera's top, as seen from behind it."""
_BESIDE_MM = 10.0  # skin within this distance outside a boundary counts as breast; not critical
_WINDOW_MM = 250.0  # skin within this distance of the breasts' middle determines the plane; not critical
_MOST_TURN_RAD = np.deg2rad(40.0)  # largest angle between the plane's normal and the cameras' left
_LOOSE_MM = 0.6  # largest standard uncertainty of a plane's position; found planes have 0.1 to 0.3
_UNLIKE_MM = 4.0  # largest scatter of a trunk about its mirror image; found planes have 0.5 to 1.8
_TURNS_DEG = 30.0  # straight ahead is searched this far to either side of the cameras' direction; not critical
_CELL_DEG, _CELL_MM = 3.0, 12.0  # size of the cells over which the trunk's radius is averaged for that search
_MISFIT_MM = 10.0  # cap on the misfit of a pair of cells; not critical
_TURN_MM_PER_DEG = 0.01  # cost of a turn, so that a round trunk keeps the cameras' direction
_FEWEST_CELLS = 60  # fewest pairs of cells that are visible on both sides; not critical
_STARTS_DEG = (0.0, -10.0, 10.0, -20.0, 20.0)  # initial turns about the axis
_FACING_ROUNDS = 3  # iterations of axis and straight ahead; not critical


@value(eq=False)
class BodyDirections:
    """The patient's own directions, and the mid-sagittal plane."""

    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead. World frame, orthonormal."""
    point_world: Float64[Array, 3]
    """A point of the mid-sagittal plane, mm."""
    plane_sigma_mm: float | None
    """Standard uncertainty of the plane's position along its normal, mm. None without a plane; the frame is then that
    of the cameras."""
    scatter_mm: float | None
    """Robust standard deviation of the trunk, without the breasts, from its mirror image, mm. None without a plane."""
    by_breasts: bool = False
    """Whether left is along the line between the breasts, because the trunk has no plane of symmetry."""

    @property
    def left(self) -> Float64[Array, 3]:
        """Unit vector to the patient's left."""
        return self.frame[0]

    @property
    def up(self) -> Float64[Array, 3]:
        """Unit vector to the patient's head, along the trunk."""
        return self.frame[1]

    @property
    def plane(self) -> MirrorPlane | None:
        """The mid-sagittal plane, or None."""
        if self.plane_sigma_mm is None or self.scatter_mm is None:
            return None
        return MirrorPlane(
            point_world=self.point_world,
            normal_world=self.left,
            sigma_mm=self.plane_sigma_mm,
            scatter_mm=self.scatter_mm,
        )


def camera_up(camera: Camera, mounting: Mounting = "upright") -> Float64[Array, 3]:
    """Unit vector upwards for a mounted camera, world frame."""
    right, down, _ = camera.camera_from_world.rotation
    return np.asarray({"upright": -down, "upside-down": down, "left": right, "right": -right}[mounting])


def rig_frame(rig: Rig, mounting: Mapping[str, Mounting] | None = None) -> Float64[Array, "3 3"]:
    """Patient's left, head and straight ahead (rows), from cameras that are upright on average.

    Args:
        rig: the calibrated cameras.
        mounting: camera → how it is mounted; all others are upright.
    """
    known = mounting or {}
    up = np.mean([camera_up(camera, known.get(name, "upright")) for name, camera in rig.cameras.items()], axis=0)
    ahead = -np.mean([camera.axis_world for camera in rig.cameras.values()], axis=0)
    return orthonormal(up, ahead)


def find_body(
    surface: RepairedSurface,
    rough: Float64[Array, "3 3"],
    *,
    boundaries: Sequence[Float64[Array, "_ 3"]] = (),
    skin: SkinSamples | None = None,
    stated: bool = False,
) -> BodyDirections:
    """Body frame from the trunk's axis and mid-sagittal plane, or else from the breasts or the cameras.

    Args:
        surface: the repaired mesh, world frame, mm.
        rough: patient's left, head, straight ahead (rows), from the cameras (`rig_frame`).
        boundaries: curves around the breasts, whose skin is excluded; without them the breasts are outliers of the
            symmetry. Two of them determine the trunk's direction.
        skin: the visible skin, if already known.
        stated: whether the user stated the head's direction, which is then not tested.

    Raises:
        MeasureError: the trunk is perpendicular to the rough frame's up.
    """
    skin = seen_skin(surface) if skin is None else skin
    if not stated and (_one_above_the_other(boundaries, rough) if len(boundaries) == 2 else lies_across(skin, rough)):
        raise MeasureError(
            "torso",
            found="a trunk across the assumed upward direction",
            expected="a trunk along this direction",
            remedy='State in session.toml how the cameras are mounted: rig.mounting = "left" or "right"',
            mesh_remedy="Give the file's axis towards the head, for example --head x",
        )
    middle = np.mean([curve.mean(axis=0) for curve in boundaries], axis=0) if boundaries else None
    if boundaries:  # a large breast's upper slope is as straight as a trunk, and up to 30° oblique to it
        breast = np.any([within_boundary(skin.points_world, curve) for curve in boundaries], axis=0)
        skin = skin if breast.all() else skin.chosen(~breast)
    frame, point = rough, skin.points_world.mean(axis=0) if middle is None else middle
    try:
        trunk = _facing_ahead(skin, find_trunk(skin, rough, height_of=middle), middle)
        frame, point = trunk.frame, trunk.origin
        plane = _plane(skin, trunk, boundaries, middle)
    except MeasureError:
        by_breasts = len(boundaries) == 2
        return BodyDirections(
            frame=_level_with(boundaries, frame) if by_breasts else frame,
            point_world=point,
            plane_sigma_mm=None,
            scatter_mm=None,
            by_breasts=by_breasts,
        )
    return BodyDirections(
        frame=_frame(plane.normal_world, trunk.frame[1], trunk.frame[2]),
        point_world=plane.point_world,
        plane_sigma_mm=plane.sigma_mm,
        scatter_mm=plane.scatter_mm,
    )


def _facing_ahead(skin: SkinSamples, first: Trunk, middle: Float64[Array, 3] | None) -> Trunk:
    """The trunk turned about its axis to the direction of greatest symmetry.

    Several initial turns are tried, because the turn determines which skin counts as the trunk's sides.
    """

    def turned(trunk: Trunk, angle_rad: float) -> tuple[float, float, Trunk]:
        again = find_trunk(skin, trunk.facing(angle_rad), height_of=middle)
        return (*_least_asymmetry(skin, again), again)

    tried = []
    for angle_deg in _STARTS_DEG:
        try:
            tried.append(turned(first, np.deg2rad(angle_deg)))
        except MeasureError:
            continue  # no skin of the sides is visible in that direction
    best = min(tried, key=lambda scored: scored[0]) if tried else turned(first, 0.0)
    for _ in range(_FACING_ROUNDS):
        again = turned(best[2], best[1])
        if again[0] > best[0]:
            break
        best = again
    return best[2]


def _least_asymmetry(skin: SkinSamples, trunk: Trunk) -> tuple[float, float]:
    """Least asymmetry of the trunk's radius (mean capped misfit), mm, and its angle about the axis, rad."""
    cylindrical = trunk.cylindrical(skin.about(TRUNK_SAMPLES).points_world)
    theta = np.rad2deg(cylindrical[:, 0] / trunk.half_width_mm)
    keep = (np.abs(cylindrical[:, 1]) < HEIGHT_WINDOW_MM) & (np.abs(theta) < WIDEST_DEG)
    keep &= on_trunk(cylindrical, trunk)
    columns, rows = int(2 * WIDEST_DEG / _CELL_DEG) + 1, int(2 * HEIGHT_WINDOW_MM / _CELL_MM) + 1
    column = np.round((theta[keep] + WIDEST_DEG) / _CELL_DEG).astype(int).clip(0, columns - 1)
    row = np.round((cylindrical[keep, 1] + HEIGHT_WINDOW_MM) / _CELL_MM).astype(int).clip(0, rows - 1)
    cell = row * columns + column
    count = np.bincount(cell, minlength=rows * columns)
    sums = np.bincount(cell, cylindrical[keep, 2], minlength=rows * columns)
    radius = np.where(count > 0, sums / np.maximum(count, 1), np.nan).reshape(rows, columns)
    middle, most = (columns - 1) / 2, _TURNS_DEG / _CELL_DEG
    shifts = np.arange(int(np.ceil(2 * (middle - most))), int(2 * (middle + most)) + 1)  # twice the middle's index
    unlike = np.full(len(shifts), np.inf)
    place = np.arange(columns)
    for number, twice in enumerate(shifts):
        partner = twice - place
        inside = (partner > place) & (partner < columns)
        apart = np.abs(radius[:, place[inside]] - radius[:, partner[inside]])
        apart = apart[np.isfinite(apart)]
        if len(apart) >= _FEWEST_CELLS:  # misfits are capped: a missing breast counts little
            turned_deg = abs(twice / 2 - middle) * _CELL_DEG
            unlike[number] = float(np.minimum(apart, _MISFIT_MM).mean()) + _TURN_MM_PER_DEG * turned_deg
    if not np.isfinite(unlike).any():
        return np.inf, 0.0
    best = int(np.argmin(unlike))
    return float(unlike[best]), float(np.deg2rad((shifts[best] / 2 - middle) * _CELL_DEG))


def lies_across(skin: SkinSamples, frame: Float64[Array, "3 3"]) -> bool:
    """Whether the trunk's axis is along the frame's left, because the cameras are rolled by 90°.

    The axis is searched from the frame's left and from its up. Of the two results, that with more skin parallel to it
    is used. Upright torsos have a share of 0.46 to 0.49 along the trunk, and 0.27 to 0.36 across.
    """
    normals = skin.about(TRUNK_SAMPLES).normals_world

    axis, _ = max((level_axis(normals, start) for start in frame[:2]), key=lambda found: found[1])
    return abs(float(axis @ frame[0])) > abs(float(axis @ frame[1]))


def _one_above_the_other(curves: Sequence[Float64[Array, "_ 3"]], frame: Float64[Array, "3 3"]) -> bool:
    """Whether both breasts are one above the other in the frame, because the trunk is across it."""
    aside, up, _ = frame @ (curves[0].mean(axis=0) - curves[1].mean(axis=0))
    return bool(abs(up) > abs(aside))


def _level_with(curves: Sequence[Float64[Array, "_ 3"]], frame: Float64[Array, "3 3"]) -> Float64[Array, "3 3"]:
    """The frame turned about its up so that its left is parallel to the line between two curves."""
    across = curves[0].mean(axis=0) - curves[1].mean(axis=0)
    return orthonormal(frame[1], np.cross(across if across @ frame[0] > 0 else -across, frame[1]))


def _plane(
    skin: SkinSamples, trunk: Trunk, boundaries: Sequence[Float64[Array, "_ 3"]], middle: Float64[Array, 3] | None
) -> MirrorPlane:
    """The trunk's mid-sagittal plane.

    Raises:
        MeasureError: the trunk is not symmetric about a plane near the middle.
    """
    some = skin.about(TRUNK_SAMPLES)
    points, normals = some.points_world, some.normals_world
    centre = trunk.origin if middle is None else middle
    keep = on_trunk(trunk.cylindrical(points), trunk) & (np.linalg.norm(points - centre, axis=1) < _WINDOW_MM)
    for boundary in boundaries:
        keep &= ~within_boundary(points, boundary)
    plane = mirror_plane(points[keep], normals[keep], trunk.origin, trunk.frame[0])
    turned = np.arccos(np.clip(plane.normal_world @ trunk.frame[0], -1, 1))
    if turned > _MOST_TURN_RAD or plane.sigma_mm > _LOOSE_MM or plane.scatter_mm > _UNLIKE_MM:
        raise MeasureError(
            "mid-sagittal plane",
            found=f"mirror images that differ by {plane.scatter_mm:.1f} mm",
            expected="a symmetric trunk",
            remedy="Photograph the trunk from both sides",
            mesh_remedy="Scan the trunk from both sides",
        )
    return plane


def _frame(left: Float64[Array, 3], up: Float64[Array, 3], ahead: Float64[Array, 3]) -> Float64[Array, "3 3"]:
    """Rows left, up, ahead, with up orthogonal to left."""
    up = up - left * (left @ up)
    up /= np.linalg.norm(up)
    forward = np.cross(left, up)
    return np.stack([left, up, forward if forward @ ahead > 0 else -forward])


def within_boundary(points: Float64[Array, "n 3"], boundary: Float64[Array, "b 3"]) -> Bool[Array, " n"]:
    """Mask of the points inside a boundary or within 10 mm of it.

    A point is inside if, seen along the boundary's normal, it is nearer to the boundary's centre than the boundary is
    in that direction. Skin that hangs over the boundary is inside too.
    """
    centre = boundary.mean(axis=0)
    _, _, axes = np.linalg.svd(boundary - centre, full_matrices=False)
    flat, outline = (points - centre) @ axes[:2].T, (boundary - centre) @ axes[:2].T
    around = np.arctan2(outline[:, 1], outline[:, 0])
    order = np.argsort(around)
    reach = np.interp(
        np.arctan2(flat[:, 1], flat[:, 0]), around[order], np.linalg.norm(outline, axis=1)[order], period=2 * np.pi
    )
    size = float(np.linalg.norm(outline, axis=1).max())
    before = np.abs((points - centre) @ axes[2]) < 2 * size  # excludes the back, far behind the breast
    return (np.linalg.norm(flat, axis=1) < reach + _BESIDE_MM) & before
