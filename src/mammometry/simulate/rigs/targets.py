"""Calibration targets for virtual rigs, and their visible points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Bool, Camera, Float64, Transform

_USEFUL_DEG = 70.0
"""Largest angle between a board's normal and the line of sight. Made up."""
_DOT_USEFUL_DEG = 60.0
"""The same for a dot on a body. `find_cylinder` measures none at larger angles."""
_USEFUL_POINTS = 12
"""Fewest visible points of a picture that is kept: more than a target's `least_points`, because some are not found."""
_RIGHTWARD_DEG = 60.0
"""Largest angle between the x axis and the picture's right for a board that looks the same after half a turn: less than
90°, with a margin for the camera's roll."""


def _dotted_box(side_mm: float, dots: int, pitch_mm: float) -> tuple[tuple[float, float, float], ...]:
    """Dots in square grids on the faces of a cube around the origin, mm, in the order −x, +x, −y, …."""
    steps = ((np.arange(dots) - 0.5 * (dots - 1)) * pitch_mm).tolist()
    half = 0.5 * side_mm
    points = []
    for axis in range(3):
        for sign in (-half, half):
            for b in steps:
                for a in steps:
                    point = [a, b]
                    point.insert(axis, sign)
                    points.append((point[0], point[1], point[2]))
    return tuple(points)


BOARD = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
"""Default board of the virtual rig."""
VIRTUAL_TARGETS: Mapping[str, Target] = MappingProxyType(
    {
        "charuco": BOARD,
        # With an odd sum of columns and rows, the pattern is not the same after half a turn.
        "chessboard": ChessboardTarget(squares=(11, 8), square_mm=22.0),
        "circles": CirclesTarget(grid=(11, 8), pitch_mm=20.0, diameter_mm=11.0),
        "circles-asymmetric": CirclesTarget(grid=(5, 11), pitch_mm=17.0, diameter_mm=13.0, asymmetric=True),
        "dotted-cylinder": DottedCylinderTarget(
            dots=(11, 30), radius_mm=30 * 12.0 / (2 * math.pi), row_pitch_mm=12.0, column_pitch_mm=12.0, dot_mm=6.0
        ),
        "frame": PointsTarget(points_mm=_dotted_box(150.0, 6, 24.0), dot_diameter_mm=9.0),
    }
)
"""Name on the command line → target."""


def make_target(name: str) -> Target:
    """A target by its name in `VIRTUAL_TARGETS`.

    Raises:
        ValueError: the name is unknown.
    """
    if name not in VIRTUAL_TARGETS:
        raise UnknownWordError(f"targets are {', '.join(VIRTUAL_TARGETS)}", f"{name!r}")
    return VIRTUAL_TARGETS[name]


def described(target: Target) -> dict[str, object]:
    """Table ``[target]`` for session.toml: the target's kind, and fields that differ from the defaults."""
    defaults = {field.name: field.default for field in fields(target)}  # type: ignore[arg-type]  # every kind is a dataclass
    values = {name: getattr(target, name) for name in defaults}
    return {"kind": target.kind} | {name: value for name, value in values.items() if value != defaults[name]}


def visible_points(camera: Camera, rig_from_target: Transform, target: Target) -> Bool[Array, " n"]:
    """Mask of the target points that are in the picture and face the camera, not too obliquely.

    All targets are convex, so that nothing else can hide a point.
    """
    points = rig_from_target.apply(target.points_target)
    towards = camera.centre_world - points
    cosine = (towards * rig_from_target.rotate(target.body.normals_target)).sum(axis=1) / np.linalg.norm(
        towards, axis=1
    )
    limit_deg = _DOT_USEFUL_DEG if target.is_surveyed else _USEFUL_DEG
    seen: Bool[Array, " n"] = _in_frame(camera, camera.project(points)) & (cosine >= math.cos(math.radians(limit_deg)))
    return seen


def sees_target(camera: Camera, rig_from_target: Transform, target: Target) -> bool:
    """Whether the camera's picture of the target is kept."""
    return useful_points(camera, rig_from_target, target) is not None


def useful_points(camera: Camera, rig_from_target: Transform, target: Target) -> Bool[Array, " n"] | None:
    """Mask of the visible points, if the picture is kept. None if it is not.

    The picture must have enough points and everything that detection needs. If a target looks the same after half a
    turn, its x axis must point to the right in every picture.
    """
    seen = visible_points(camera, rig_from_target, target)
    if int(seen.sum()) < _USEFUL_POINTS:
        return None

    def in_picture(points_target: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
        return _in_frame(camera, camera.project(rig_from_target.apply(points_target)))

    body = target.body
    whole = body.is_whole(seen, in_picture)
    return seen if whole and (not body.looks_alike_turned or _points_right(camera, rig_from_target)) else None


def _in_frame(camera: Camera, uv: Float64[Array, "n 2"]) -> Bool[Array, " n"]:
    with np.errstate(invalid="ignore"):  # NaN: behind the camera
        return np.asarray(np.all((uv >= 0.0) & (uv <= np.array(camera.size_wh) - 1.0), axis=1))


def _points_right(camera: Camera, rig_from_target: Transform) -> bool:
    x = camera.camera_from_world.rotate(rig_from_target.rotation[:, 0][None])[0]
    return math.degrees(math.atan2(abs(float(x[1])), float(x[0]))) < _RIGHTWARD_DEG
