"""Map of a cylinder's printed surface to a distorted photograph.

A projective camera, then a cubic lens: eleven projective parameters and a cubic of the picture's coordinates. They are
found from the dots of one photograph alone, without calibration. Turning the numbering of rows or columns only moves
the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.calibration.features.board_map import fit_polynomial
from mammometry.calibration.features.corner_fit import monomials
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.arrays import Array, Bool, Float64

_ROUNDS = 4
"""Fits of projection and lens in turn. Chosen by eye."""
_LEAST = 24
"""Fewest dots for a map: eleven parameters and a lens need many more than six. Chosen by eye."""
_FORM_TOLERANCE = 0.05
"""Largest distance of a dot from its place, as share of a pitch: printed rows and wrapped sheets reach it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CylinderMap:
    """A smooth map from the unrolled surface, mm, to the photograph, pixels.

    Unrolled coordinates are along the arc and along the axis.
    """

    target: DottedCylinderTarget
    projection: Float64[Array, "3 4"]
    """To ideal pixels, those of a lens without distortion."""
    to_ideal: Float64[Array, "10 2"]
    to_distorted: Float64[Array, "10 2"]
    centre_px: Float64[Array, 2]
    scale_px: float

    def image(self, unrolled_mm: Float64[Array, "*n 2"]) -> Float64[Array, "*n 2"]:
        """Distorted pixels of points of the surface."""
        ideal = _project(self.projection, self.target.on_surface(unrolled_mm[..., 0], unrolled_mm[..., 1]))
        return ideal + monomials((ideal - self.centre_px) / self.scale_px) @ self.to_distorted

    def jacobian(self, unrolled_mm: Float64[Array, "*n 2"], step_mm: float = 0.2) -> Float64[Array, "*n 2 2"]:
        """Derivative of uv by unrolled coordinates, pixels per mm. Column j belongs to coordinate j."""
        steps = np.eye(2) * step_mm
        columns = [(self.image(unrolled_mm + step) - self.image(unrolled_mm - step)) / (2 * step_mm) for step in steps]
        return np.stack(columns, axis=-1)

    def facing(self, unrolled_mm: Float64[Array, "*n 2"]) -> Float64[Array, "*n"]:
        """Cosine between the surface's outward normal and the camera direction."""
        centre_mm = -np.linalg.solve(self.projection[:, :3], self.projection[:, 3])
        points = self.target.on_surface(unrolled_mm[..., 0], unrolled_mm[..., 1])
        towards = centre_mm - points
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        outward = points[..., :2] / self.target.radius_mm
        cosine: Float64[Array, "*n"] = (towards[..., :2] * outward).sum(axis=-1)
        return cosine


def fit_cylinder_map(
    target: DottedCylinderTarget, unrolled_mm: Float64[Array, "n 2"], uv: Float64[Array, "n 2"]
) -> tuple[CylinderMap, Bool[Array, " n"]] | None:
    """Fit the map robustly.

    Returns it with the mask of the dots it explains, or None where it explains too few.
    """
    points = target.on_surface(unrolled_mm[:, 0], unrolled_mm[:, 1])
    used = np.ones(len(uv), bool)
    if len(uv) < _LEAST:
        return None
    centre_px = uv.mean(axis=0)
    scale_px = float(np.abs(uv - centre_px).max())
    to_ideal, to_distorted = np.zeros((10, 2)), np.zeros((10, 2))
    fitted = None
    for round_ in range(_ROUNDS):
        if used.sum() < max(_LEAST, 0.5 * len(uv)):
            return None
        ideal = uv + monomials((uv - centre_px) / scale_px) @ to_ideal
        projection = _direct_linear(points[used], ideal[used])
        projected = _project(projection, points)
        if round_:
            to_ideal = fit_polynomial((uv[used] - centre_px) / scale_px, projected[used] - uv[used], 10)
            argument = (projected[used] - centre_px) / scale_px
            to_distorted = fit_polynomial(argument, uv[used] - projected[used], 10)
        fitted = CylinderMap(
            target=target,
            projection=projection,
            to_ideal=to_ideal,
            to_distorted=to_distorted,
            centre_px=centre_px,
            scale_px=scale_px,
        )
        error = np.linalg.norm(fitted.image(unrolled_mm) - uv, axis=1)
        pitch_px = np.abs(np.linalg.det(fitted.jacobian(unrolled_mm))) ** 0.5 * target.row_pitch_mm
        used = error < np.maximum(5.0 * 1.4826 * np.median(error), _FORM_TOLERANCE * pitch_px)
    return None if fitted is None else (fitted, used)


def _direct_linear(points: Float64[Array, "n 3"], uv: Float64[Array, "n 2"]) -> Float64[Array, "3 4"]:
    """Projective camera by the normalised direct linear transform. Positive depth, unit third row."""
    middle, spread = points.mean(axis=0), float(np.abs(points - points.mean(axis=0)).max())
    centre, scale = uv.mean(axis=0), float(np.abs(uv - uv.mean(axis=0)).max())
    homogeneous = np.column_stack([(points - middle) / spread, np.ones(len(points))])
    image = (uv - centre) / scale
    zero = np.zeros_like(homogeneous)
    rows = np.concatenate(
        [
            np.column_stack([homogeneous, zero, -image[:, :1] * homogeneous]),
            np.column_stack([zero, homogeneous, -image[:, 1:] * homogeneous]),
        ]
    )
    _, vectors = np.linalg.eigh(rows.T @ rows)
    to_points = np.diag([1 / spread, 1 / spread, 1 / spread, 1.0])
    to_points[:3, 3] = -middle / spread
    from_image = np.array([[scale, 0, centre[0]], [0, scale, centre[1]], [0, 0, 1.0]])
    projection = from_image @ vectors[:, 0].reshape(3, 4) @ to_points
    projection /= np.linalg.norm(projection[2, :3])
    depth = np.column_stack([points, np.ones(len(points))]) @ projection[2]
    return projection if np.median(depth) > 0 else -projection


def _project(projection: Float64[Array, "3 4"], points: Float64[Array, "*n 3"]) -> Float64[Array, "*n 2"]:
    homogeneous = points @ projection[:, :3].T + projection[:, 3]
    return homogeneous[..., :2] / homogeneous[..., 2:]
