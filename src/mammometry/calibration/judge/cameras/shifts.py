"""How the points that a pair measures move with its cameras' parameters.

A point is taken on the left camera's ray, nearest to the right one's, as `surface.range_image` does: what turns the
right ray out of the epipolar plane shows as vertical disparity and moves no point.
"""

from __future__ import annotations

import numpy as np

from mammometry.base.value import value
from mammometry.calibration.judge.expected_error import derivatives
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import StereoPair


@value(eq=False)
class Shifts:
    """First-order effects of parameters on what a pair measures at some points."""

    points_mm: Float64[Array, "n 3 p"]
    """Displacement of the true point from the measured one per unit error of a parameter, world axes, mm."""
    vertical_rad: Float64[Array, "n p"]
    """Vertical disparity d_v per unit error, as an angle at the right camera: d_v over focal length."""


def shifts(pair: StereoPair, points: Float64[Array, "n 3"], names: tuple[str, ...]) -> Shifts:
    """Propagate parameters' errors through one pair's triangulation.

    The right parameters being θ + dθ, the same image points mean X + dX: P dX + Q dθ is 0 in the left picture, and in
    the right one what a point s above X shows, since both rays miss each other by s, square to the epipolar plane. P
    and Q are the derivatives of the projections; s over the distance is the vertical disparity's angle.

    Args:
        pair: as calibrated.
        points: that it measures, world frame, mm; in front of both cameras.
        names: of the parameters, as in `ParameterCovariance.names`. Those of other cameras give zeros.
    """
    (p_left, q_left), (p_right, q_right) = (derivatives(camera, points, names) for camera in (pair.left, pair.right))
    upwards = np.einsum("nij,nj->ni", p_right, upright(pair, points))  # px for each mm out of the epipolar plane
    system = np.zeros((len(points), 4, 4))
    system[:, :2, :3], system[:, 2:, :3], system[:, 2:, 3] = p_left, p_right, -upwards
    solved = -np.linalg.solve(system, np.concatenate([q_left, q_right], axis=1))
    distance_mm = np.linalg.norm(points - pair.right.centre_world, axis=1)
    return Shifts(points_mm=solved[:, :3], vertical_rad=-solved[:, 3] / distance_mm[:, None])


def upright(pair: StereoPair, points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
    """Unit normals of the epipolar planes through points, world axes.

    They point to the side to which rows are counted.
    """
    baseline = pair.right.centre_world - pair.left.centre_world
    normal = np.cross(points - pair.right.centre_world, baseline)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal
