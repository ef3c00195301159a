"""The body's frame: axis, mid-sagittal plane, direction of the head.

It is found once, from the trunk. Left, up and ahead mean this frame everywhere: in the search for breasts, walls,
quadrants, ptosis, comparison, views. The cameras only show roughly where the head is, and the body itself is tested
for agreement.
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
    Skin,
    Trunk,
    find_trunk,
    level_axis,
    on_trunk,
    orthonormal,
    seen_skin,
)
from mammometry.surface.repair.repair import RepairedSurface

Mounting: TypeAlias = Literal["upright", "upside-down", "left", "right"]
"""Where a camera's top points, as seen from behind it."""

_BESIDE_MM = 10.0  # skin this near to a boundary counts as breast; chosen by eye
_WINDOW_MM = 250.0  # skin this near to the breasts' middle shows the plane; chosen by eye
_MOST_TURN_RAD = np.deg2rad(40.0)  # between the plane's normal and the cameras' left; beyond it no plane was found
_LOOSE_MM = 0.6  # a plane whose place is known no better than this is none; found ones have .1 to .3
_UNLIKE_MM = 4.0  # a trunk that is its own mirror image no better than this shows no plane; found ones have .5 to 1.8
_TURNS_DEG = 30.0  # to either side of the cameras' ahead in which straight ahead is looked for; chosen by eye
_CELL_DEG, _CELL_MM = 3.0, 12.0  # in which the trunk's radius is averaged for that
_MISFIT_MM = 10.0  # at which a misfit of both sides is limited; chosen by eye
_TURN_MM_PER_DEG = 0.01  # cost of a turn, so that a round trunk is left as the cameras have it
_FEWEST_CELLS = 60  # pairs of cells that must be seen on both sides; chosen by eye
_STARTS_DEG = (0.0, -10.0, 10.0, -20.0, 20.0)  # turns about the axis that are tried
_FACING_ROUNDS = 3  # of finding the axis and straight ahead, each from the other; chosen by eye


@value(eq=False)
class Body:
    """The patient's own directions, and where the middle is."""

    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead. World frame, orthonormal."""
    point_world: Float64[Array, 3]
    """A point of the mid-sagittal plane, mm."""
    plane_sigma_mm: float | None
    """Standard uncertainty of the plane's place along its normal, mm. None if the trunk shows no plane. The frame is
    then the cameras'."""
    scatter_mm: float | None
    """Robust standard deviation of the trunk from its mirror image, without the breasts, mm. None without a plane."""
    how: str
    """What the frame rests on, one sentence."""

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
        """The mid-sagittal plane. None if the trunk shows none."""
        if self.plane_sigma_mm is None or self.scatter_mm is None:
            return None
        return MirrorPlane(
            point_world=self.point_world,
            normal_world=self.left,
            sigma_mm=self.plane_sigma_mm,
            scatter_mm=self.scatter_mm,
        )


def camera_up(camera: Camera, mounting: Mounting = "upright") -> Float64[Array, 3]:
    """Unit vector that is up for a mounted camera, world frame."""
    right, down, _ = camera.camera_from_world.rotation
    return np.asarray({"upright": -down, "upside-down": down, "left": right, "right": -right}[mounting])


def rig_frame(rig: Rig, mounting: Mapping[str, Mounting] | None = None) -> Float64[Array, "3 3"]:
    """Patient's left, head and straight ahead, as rows, from cameras that are upright on average.

    Args:
        rig: the calibrated cameras.
        mounting: camera → how it is mounted; those that are not named are upright.
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
    skin: Skin | None = None,
    stated: bool = False,
) -> Body:
    """Find the trunk's axis and its mid-sagittal plane.

    Args:
        surface: the repaired mesh, world frame, mm.
        rough: patient's left, head, straight ahead (rows), as the cameras have it (`rig_frame`).
        boundaries: curves around the breasts, whose skin is left out; without them the breasts are outliers of the
            symmetry. Two of them show which way the trunk lies.
        skin: the visible skin, where it is known already.
        stated: whether the user said where the head is: then no sign contradicts it.

    Returns:
        The frame. Where the trunk shows no axis or no plane, that of two breasts or of the cameras, and `how` says so.

    Raises:
        MeasureError: the trunk lies across the rough frame's up.
    """
    skin = seen_skin(surface) if skin is None else skin
    if not stated and (_one_above_the_other(boundaries, rough) if len(boundaries) == 2 else lies_across(skin, rough)):
        raise MeasureError(
            "torso",
            found="a trunk across the assumed upward direction",
            expected="a trunk along this direction",
            remedy='Say in session.toml how the cameras are mounted: rig.mounting = "left" or "right"',
            mesh_remedy="Say which of the file's axes points to the head: --head x, for example",
        )
    middle = np.mean([curve.mean(axis=0) for curve in boundaries], axis=0) if boundaries else None
    if boundaries:  # a large breast's upper slope is as straight as a trunk, and leans up to 30° from it
        breast = np.any([within_boundary(skin.points_world, curve) for curve in boundaries], axis=0)
        skin = skin if breast.all() else skin.chosen(~breast)
    frame, point = rough, skin.points_world.mean(axis=0) if middle is None else middle
    try:
        trunk = _facing_ahead(skin, find_trunk(skin, rough, height_of=middle), middle)
        frame, point = trunk.frame, trunk.origin
        plane = _plane(skin, trunk, boundaries, middle)
    except MeasureError as error:
        left_as = "roughly as given"
        if len(boundaries) == 2:
            frame, left_as = _level_with(boundaries, frame), "as the breasts lie"
        return Body(
            frame=frame,
            point_world=point,
            plane_sigma_mm=None,
            scatter_mm=None,
            how=f"Left and ahead are {left_as}, because the trunk shows no plane of symmetry ({error.found})",
        )
    return Body(
        frame=_frame(plane.normal_world, trunk.frame[1], trunk.frame[2]),
        point_world=plane.point_world,
        plane_sigma_mm=plane.sigma_mm,
        scatter_mm=plane.scatter_mm,
        how="Up is along the trunk's axis, and left across its mid-sagittal plane, about which the trunk is its own "
        f"mirror image within {plane.scatter_mm:.1f} mm",
    )


def _facing_ahead(skin: Skin, first: Trunk, middle: Float64[Array, 3] | None) -> Trunk:
    """The trunk turned to face ahead.

    Of several turns about the axis it takes the one with the most alike sides, then refines it. Which skin shows the
    trunk's sides, and so where its axis lies, depends on the turn. So several are tried.
    """

    def turned(trunk: Trunk, angle_rad: float) -> tuple[float, float, Trunk]:
        again = find_trunk(skin, trunk.facing(angle_rad), height_of=middle)
        return (*_least_asymmetry(skin, again), again)

    tried = []
    for angle_deg in _STARTS_DEG:
        try:
            tried.append(turned(first, np.deg2rad(angle_deg)))
        except MeasureError:
            continue  # no skin of the sides is seen in that direction
    best = min(tried, key=lambda scored: scored[0]) if tried else turned(first, 0.0)
    for _ in range(_FACING_ROUNDS):
        again = turned(best[2], best[1])
        if again[0] > best[0]:
            break
        best = again
    return best[2]


def _least_asymmetry(skin: Skin, trunk: Trunk) -> tuple[float, float]:
    """Return the least asymmetry, mm, and the angle about the axis, rad, at which it is found.

    There the trunk's radius is most alike to both sides. The asymmetry is the mean of limited misfits.
    """
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
    shifts = np.arange(int(np.ceil(2 * (middle - most))), int(2 * (middle + most)) + 1)  # twice the place of the middle
    unlike = np.full(len(shifts), np.inf)
    place = np.arange(columns)
    for number, twice in enumerate(shifts):
        partner = twice - place
        inside = (partner > place) & (partner < columns)
        apart = np.abs(radius[:, place[inside]] - radius[:, partner[inside]])
        apart = apart[np.isfinite(apart)]
        if len(apart) >= _FEWEST_CELLS:  # a breast that the other side lacks counts no more than a limited misfit
            turned_deg = abs(twice / 2 - middle) * _CELL_DEG
            unlike[number] = float(np.minimum(apart, _MISFIT_MM).mean()) + _TURN_MM_PER_DEG * turned_deg
    if not np.isfinite(unlike).any():
        return np.inf, 0.0
    best = int(np.argmin(unlike))
    return float(unlike[best]), float(np.deg2rad((shifts[best] / 2 - middle) * _CELL_DEG))


def lies_across(skin: Skin, frame: Float64[Array, "3 3"]) -> bool:
    """Whether the trunk's axis runs along the frame's left instead of up.

    Then the cameras are rolled by 90°. The axis is the direction that most of the skin is level with, of those found
    from either start. Upright torsos have .46 to .49 of it along the trunk and .27 to .36 across.
    """
    normals = skin.about(TRUNK_SAMPLES).normals_world

    axis, _ = max((level_axis(normals, start) for start in frame[:2]), key=lambda found: found[1])
    return abs(float(axis @ frame[0])) > abs(float(axis @ frame[1]))


def _one_above_the_other(curves: Sequence[Float64[Array, "_ 3"]], frame: Float64[Array, "3 3"]) -> bool:
    """Whether both breasts lie along the frame's up, as they do where the trunk lies across it."""
    aside, up, _ = frame @ (curves[0].mean(axis=0) - curves[1].mean(axis=0))
    return bool(abs(up) > abs(aside))


def _level_with(curves: Sequence[Float64[Array, "_ 3"]], frame: Float64[Array, "3 3"]) -> Float64[Array, "3 3"]:
    """The frame turned about its up so that two curves lie level with its left."""
    across = curves[0].mean(axis=0) - curves[1].mean(axis=0)
    return orthonormal(frame[1], np.cross(across if across @ frame[0] > 0 else -across, frame[1]))


def _plane(
    skin: Skin, trunk: Trunk, boundaries: Sequence[Float64[Array, "_ 3"]], middle: Float64[Array, 3] | None
) -> MirrorPlane:
    """The trunk's mid-sagittal plane.

    Raises:
        MeasureError: the trunk is not its own mirror image about any plane near the middle.
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
    """Rows left, up, ahead, with up made square to left."""
    up = up - left * (left @ up)
    up /= np.linalg.norm(up)
    forward = np.cross(left, up)
    return np.stack([left, up, forward if forward @ ahead > 0 else -forward])


def within_boundary(points: Float64[Array, "n 3"], boundary: Float64[Array, "b 3"]) -> Bool[Array, " n"]:
    """Mask of the points inside a boundary, or within a centimetre of it.

    A point lies inside if it is nearer to the boundary's middle than the boundary is in that direction, seen along the
    boundary's normal. Skin that hangs over the boundary is inside too.
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
    before = np.abs((points - centre) @ axes[2]) < 2 * size  # not the back, far behind the breast
    return (np.linalg.norm(flat, axis=1) < reach + _BESIDE_MM) & before
