"""How the points that a pair measures move with its cameras' parameters.

A point is taken on the left camera's ray, nearest to the right one's, as `surface.range_image` does: what turns the
right ray out of the epipolar plane shows as vertical disparity and moves no point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.calibration.judge.expected_error import derivatives
from mammometry.geometry.arrays import Array, Float64, read_only
from mammometry.geometry.camera import StereoPair

_LEFT_WEIGHT = 1e4
"""Weight of the left picture beside the right one's 1: the point stays on its left ray to a ten-thousandth."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shifts:
    """First-order effects of parameters on what a pair measures at some points."""

    points_mm: Float64[Array, "n 3 p"]
    """By how much the true point lies off the measured one for each unit of a parameter's error, world axes, mm."""
    vertical_rad: Float64[Array, "n p"]
    """Vertical disparity d_v that a unit of error leaves, as an angle at the right camera: d_v over focal length."""

    def __post_init__(self) -> None:
        for field in ("points_mm", "vertical_rad"):
            object.__setattr__(self, field, read_only(getattr(self, field)))


def shifts(pair: StereoPair, points: Float64[Array, "n 3"], names: tuple[str, ...]) -> Shifts:
    """Propagate parameters' errors through one pair's triangulation.

    The right parameters being θ + dθ, the same image points mean X + dX with P dX + Q dθ = 0 in the left picture, and
    in the right one along the epipolar line; what is left across that line is the vertical disparity.

    Args:
        pair: as calibrated.
        points: that it measures, world frame, mm; in front of both cameras.
        names: of the parameters, as in `ParameterCovariance.names`. Those of other cameras give zeros.
    """
    (p_left, q_left), (p_right, q_right) = (derivatives(camera, points, names) for camera in (pair.left, pair.right))
    p = np.concatenate([_LEFT_WEIGHT * p_left, p_right], axis=1)
    q = np.concatenate([_LEFT_WEIGHT * q_left, q_right], axis=1)
    transposed = p.transpose(0, 2, 1)
    moved = -np.linalg.solve(transposed @ p, transposed @ q)
    left_over = p_right @ moved + q_right  # px of the right picture
    across = upright(pair, points)
    step = np.einsum("nij,nj->ni", p_right, across)  # px for each mm across the epipolar plane
    distance_mm = np.linalg.norm(points - pair.right.centre_world, axis=1)
    angle = np.einsum("ni,nip->np", step, left_over) / (np.sum(step**2, axis=1) * distance_mm)[:, None]
    return Shifts(points_mm=moved, vertical_rad=-angle)


def upright(pair: StereoPair, points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
    """Unit normals of the epipolar planes through points, on the side to which rows are counted; world axes."""
    baseline = pair.right.centre_world - pair.left.centre_world
    normal = np.cross(points - pair.right.centre_world, baseline)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal
