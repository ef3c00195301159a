"""Find the photographs of a walk that do not fit the common lens: another zoom, or a bent board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.geometry import Array, Camera, Float64, Transform
from mammometry.walk.inputs import LeftOut

_MOST_EXCLUDED = 0.25
"""Largest share of a photograph's corners that the robust adjustment may exclude: 3 % in clean photographs."""
_MOST_ZOOM, _ZOOM_SIGMAS = 0.03, 5.0
"""Largest difference of a photograph's focal length, relative and in standard deviations. Autofocus changes it by up to
2 % between 0.4 and 1 m. A relative error displaces the telephone by the same share of its distance."""
_CORNER_PX = 0.1  # residual beyond which the loss is linear: a corner is measured to 0.05 px


def judge_lenses(calibration: Calibration, stations: Mapping[str, Camera]) -> dict[str, LeftOut]:
    """Photographs that do not fit the common lens, with reasons.

    Args:
        calibration: of the single camera. Its poses are the photographs.
        stations: photograph → camera in the board's frame.
    """
    out = {
        aside.pose: LeftOut(
            code="another-lens",
            found=f"corners of the board that are {aside.residual_px:.1f} pixels off",
            expected="a flat board and the lens of the other pictures",
            remedy="Do not zoom during a walk, lock the focus, and keep the board flat",
        )
        for aside in calibration.set_aside
    }
    for seen, residuals in zip(calibration.observations.detections, calibration.residuals_px, strict=True):
        if seen.pose in out:
            continue
        excluded = np.isnan(residuals).any(axis=1)
        camera = stations.get(seen.pose)  # none if the adjustment excluded too many of its corners
        zoom = 0.0 if camera is None else _zoom(camera, calibration.target_points[seen.ids], seen.uv)
        if zoom:
            out[seen.pose] = LeftOut(
                code="zoom",
                found=f"a focal length of {100 * (1 + zoom):.0f} % of that of most pictures",
                expected="one focal length",
                remedy="Do not zoom during a walk, and lock the focus",
            )
        elif camera is None or excluded.mean() > _MOST_EXCLUDED:
            out[seen.pose] = LeftOut(
                code="another-lens",
                found=f"{excluded.sum()} of {len(excluded)} corners of the board that do not fit",
                expected="a flat board and the lens of the other pictures",
                remedy="Do not zoom during a walk, lock the focus, and keep the board flat",
            )
    return out


def _zoom(camera: Camera, points_world: Float64[Array, "n 3"], uv: Float64[Array, "n 2"]) -> float:
    """Relative change of the focal length; 0 if it is small or not significant."""
    change, std = focal_change(camera, points_world, uv)
    return change if abs(change) > max(_MOST_ZOOM, _ZOOM_SIGMAS * std) else 0.0


def focal_change(camera: Camera, points_world: Float64[Array, "n 3"], uv: Float64[Array, "n 2"]) -> tuple[float, float]:
    """Relative change of the focal length that fits a photograph best, and its standard deviation.

    The camera's pose is adjusted with it.

    Args:
        camera: the camera; its principal point and distortion are kept.
        points_world: points that it sees, mm.
        uv: their pixels.
    """
    far_mm = float(np.linalg.norm(camera.centre_world - points_world.mean(axis=0)))

    def residuals(step: Float64[Array, 7]) -> Float64[Array, " m"]:
        turn = Transform.from_rotation_vector(step[:3], far_mm * step[3:6])
        matrix = camera.matrix.copy()
        matrix[[0, 1], [0, 1]] *= np.exp(step[6])
        moved = replace(camera, matrix=matrix, camera_from_world=turn @ camera.camera_from_world)
        return (moved.project(points_world) - uv).ravel()

    fitted = least_squares(residuals, np.zeros(7), loss="soft_l1", f_scale=_CORNER_PX)
    freedom = max(1, len(fitted.fun) - len(fitted.x))
    variance = 2.0 * fitted.cost / freedom
    jacobian = np.asarray(fitted.jac, dtype=np.float64)
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian)
    return float(np.expm1(fitted.x[6])), float(np.sqrt(covariance[6, 6]))
