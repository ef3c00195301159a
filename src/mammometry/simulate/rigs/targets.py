"""The calibration targets of the virtual rig: which kinds there are, and which of their points a camera sees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType

import numpy as np

from mammometry.calibration.targets.target import (
    CharucoTarget,
    ChessboardTarget,
    CirclesTarget,
    DottedCylinderTarget,
    PointsTarget,
    Target,
)
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

_USEFUL_DEG = 70.0
"""A flat board seen more aslant than this is not worth a photograph."""
_DOT_USEFUL_DEG = 60.0
"""A dot of a body that is seen more aslant than this is not measured."""
_USEFUL_POINTS = 12
_RIGHTWARD_DEG = 60.0
"""How far from the picture's right the x axis may point of a board that looks the same after half a turn."""


def _dotted_box(side_mm: float, dots: int, pitch_mm: float) -> tuple[tuple[float, float, float], ...]:
    """Dots in a square grid on the six faces of a cube around the origin, mm, face by face (−x, +x, −y, …)."""
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
"""The board of the virtual rig, unless another target is asked for."""
TARGETS: Mapping[str, Target] = MappingProxyType(
    {
        "charuco": BOARD,
        # An odd sum of columns and rows: half a turn does not give the same pattern.
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
    """Return a target by its name in `TARGETS`.

    Raises:
        ValueError: there is no target of that name.
    """
    if name not in TARGETS:
        raise ValueError(f"targets are {', '.join(TARGETS)}, found {name!r}")
    return TARGETS[name]


def described(target: Target) -> dict[str, object]:
    """What session.toml's ``[target]`` says of this target: its kind, and all that differs from the defaults."""
    defaults = {field.name: field.default for field in fields(target)}
    values = {name: getattr(target, name) for name in defaults}
    return {"kind": target.kind} | {name: value for name, value in values.items() if value != defaults[name]}


def outward_normals(target: Target) -> Float64[Array, "n 3"]:
    """Unit normals of the printed surface at the target's points, target frame."""
    points = target.points_target
    if isinstance(target, DottedCylinderTarget):
        return np.asarray(points * np.array([1.0, 1.0, 0.0]) / target.radius_mm)
    if isinstance(target, PointsTarget):  # a box around the origin
        normals = np.zeros_like(points)
        axis = np.abs(points).argmax(axis=1)
        rows = np.arange(len(points))
        normals[rows, axis] = np.sign(points[rows, axis])
        return normals
    return np.broadcast_to([0.0, 0.0, -1.0], points.shape)


def visible_points(camera: Camera, rig_from_target: Transform, target: Target) -> Bool[Array, " n"]:
    """Which points of the target are in the frame, on the side that faces the camera and not too aslant.

    All our targets are convex, so that nothing else can hide a point.
    """
    points = rig_from_target.apply(target.points_target)
    towards = camera.centre_world - points
    cosine = (towards * rig_from_target.rotate(outward_normals(target))).sum(axis=1) / np.linalg.norm(towards, axis=1)
    limit_deg = _DOT_USEFUL_DEG if target.is_surveyed else _USEFUL_DEG
    uv = camera.project(points)
    with np.errstate(invalid="ignore"):
        inside = np.all((uv >= 0.0) & (uv <= np.array(camera.size_wh) - 1.0), axis=1)
    seen: Bool[Array, " n"] = inside & (cosine >= math.cos(math.radians(limit_deg)))
    return seen


def sees_target(camera: Camera, rig_from_target: Transform, target: Target) -> bool:
    """Whether the camera's picture of the target is worth keeping: enough points, and all where detection wants all.

    A ChArUco board and a list of points may be cropped. The other kinds are identified by their whole grid; one that
    looks the same after half a turn must also lie with its x axis to the right in every picture.
    """
    seen = visible_points(camera, rig_from_target, target)
    if int(seen.sum()) < _USEFUL_POINTS:
        return False
    if isinstance(target, CharucoTarget | PointsTarget):
        return True
    outline = camera.project(rig_from_target.apply(_outline(target)))
    if isinstance(target, DottedCylinderTarget):
        outline = outline[np.isin(np.arange(len(outline)) % target.dots[1], np.flatnonzero(_columns(seen, target)))]
    elif not seen.all():
        return False
    with np.errstate(invalid="ignore"):
        whole = bool(np.all((outline >= 0.0) & (outline <= np.array(camera.size_wh) - 1.0)))
    return whole and (not looks_alike_turned(target) or _points_right(camera, rig_from_target))


def looks_alike_turned(target: Target) -> bool:
    """Whether half a turn in its plane gives the same board, so that only its direction in the picture tells."""
    if isinstance(target, ChessboardTarget):
        return sum(target.squares) % 2 == 0
    return isinstance(target, CirclesTarget) and (not target.asymmetric or target.grid[1] % 2 == 0)


def extent_mm(target: CharucoTarget | ChessboardTarget | CirclesTarget) -> Float64[Array, "2 2"]:
    """First and last corner (x, y) of what is printed on a flat board, mm; its white border lies outside."""
    if isinstance(target, CirclesTarget):
        points = target.points_target[:, :2]
        return np.array([points.min(axis=0), points.max(axis=0)]) + target.diameter_mm * np.array([[-0.5], [0.5]])
    return np.array([[0.0, 0.0], np.array(target.squares) * target.square_mm])


def middle_mm(target: Target) -> Float64[Array, 3]:
    """Middle of the target, target frame, mm: what is held in the middle of the rig."""
    if isinstance(target, DottedCylinderTarget | PointsTarget):
        points = target.points_target
        return 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.append(extent_mm(target).mean(axis=0), 0.0)


def _outline(target: Target) -> Float64[Array, "n 3"]:
    """Points that must be in the picture for the whole target to be: corners, or both ends of all columns."""
    if isinstance(target, DottedCylinderTarget):
        rows, columns = target.dots
        arc = np.tile(np.arange(columns) * target.column_pitch_mm, 2)
        height = np.repeat([-0.8, rows - 1 + 1.5], columns) * target.row_pitch_mm
        return target.on_surface(arc, height)
    if isinstance(target, PointsTarget):
        return target.points_target
    (left, top), (right, bottom) = extent_mm(target)
    return np.array([[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])


def _columns(seen: Bool[Array, " n"], target: DottedCylinderTarget) -> Bool[Array, " c"]:
    """Columns of the cylinder of which any dot is seen."""
    return np.asarray(seen.reshape(target.dots).any(axis=0))


def _points_right(camera: Camera, rig_from_target: Transform) -> bool:
    x = camera.camera_from_world.rotate(rig_from_target.rotation[:, 0][None])[0]
    return math.degrees(math.atan2(abs(float(x[1])), float(x[0]))) < _RIGHTWARD_DEG
