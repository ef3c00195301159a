"""Smooth map from a flat board to a distorted photograph: a homography, then a cubic lens polynomial.

The polynomial is a function of *image* coordinates. So Brown's k1, p1, p2 are represented exactly, and a board that
fills part of the frame needs no more terms than one that fills all of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mammometry.base.normal import MAD
from mammometry.calibration.features.pixels import MIN_POINTS
from mammometry.geometry.arrays import Array, Float64

LENS_TOLERANCE = 0.006
"""Largest deviation of a board from a homography by lens distortion, image widths."""
_CUBIC_POINTS = 40
"""Fewest points for a cubic lens, ten coefficients per coordinate."""
_QUADRATIC_POINTS = 20
"""Fewest points for a quadratic lens, six coefficients per coordinate. With fewer the lens is ignored."""
_ROUNDS = 3
"""Alternating fits of homography and lens."""
_RIDGE = 1e-6
"""Regularisation: share of the number of points added to the normal equations' diagonal, for points on a line."""


def search_tolerance_px(size_wh: tuple[int, int], scale: Float64[Array, 2]) -> float:
    """Largest distance of points in a reduced image of that scale from a plain homography, px."""
    return LENS_TOLERANCE * max(size_wh) + 2.0 * float(scale.max())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardMap:
    """A smooth map between the board's plane, mm, and the photograph, px, in both directions."""

    ideal_from_board: Float64[Array, "3 3"]
    """Homography to ideal pixels, those of a lens without distortion."""
    to_ideal: Float64[Array, "10 2"]
    """Cubic polynomial of normalised distorted pixels: correction that gives ideal ones, pixels."""
    to_distorted: Float64[Array, "10 2"]
    """Cubic polynomial of normalised ideal pixels: correction that gives distorted ones, pixels."""
    centre_px: Float64[Array, 2]
    scale_px: float
    """Normalisation of the polynomials' arguments: (uv − centre) / scale."""

    def image(self, board_mm: Float64[Array, "*n 2"]) -> Float64[Array, "*n 2"]:
        """Distorted pixels of points of the board, mm."""
        ideal = _project(self.ideal_from_board, board_mm)
        return ideal + monomials((ideal - self.centre_px) / self.scale_px) @ self.to_distorted

    def board(self, uv: Float64[Array, "*n 2"]) -> Float64[Array, "*n 2"]:
        """Points of the board, mm, at distorted pixels."""
        ideal = uv + monomials((uv - self.centre_px) / self.scale_px) @ self.to_ideal
        return _project(np.linalg.inv(self.ideal_from_board), ideal)

    def jacobian(self, board_mm: Float64[Array, "n 2"]) -> Float64[Array, "n 2 2"]:
        """Derivative of uv by board coordinates, pixels per mm. Column j belongs to board axis j."""
        halves = 0.5 * np.eye(2)  # central difference over 1 mm
        columns = [self.image(board_mm + half) - self.image(board_mm - half) for half in halves]
        return np.stack(columns, axis=-1)


def fit_board_map(
    board_mm: Float64[Array, "n 2"], uv: Float64[Array, "n 2"], *, tolerance_px: float
) -> tuple[BoardMap, np.ndarray] | None:
    """Fit the map robustly.

    Also returns the mask of the points that it explains. None if there is no map. A mirrored image has none: a board is
    seen from its front.

    Args:
        board_mm: points of the board.
        uv: their positions in the image, px.
        tolerance_px: largest distance of a good point from a plain homography, including lens distortion.
    """
    if len(board_mm) < MIN_POINTS:
        return None
    homography, inside = cv2.findHomography(
        board_mm.reshape(-1, 1, 2), uv.reshape(-1, 1, 2), cv2.RANSAC, tolerance_px, maxIters=2000, confidence=0.999
    )
    if homography is None or inside.sum() < max(MIN_POINTS, 0.5 * len(board_mm)):
        return None
    used = inside.ravel().astype(bool)
    centre_px = uv[used].mean(axis=0)
    scale_px = float(np.abs(uv[used] - centre_px).max()) or 1.0
    zeros = np.zeros((10, 2))
    fitted = BoardMap(
        ideal_from_board=homography, to_ideal=zeros, to_distorted=zeros, centre_px=centre_px, scale_px=scale_px
    )
    for _ in range(_ROUNDS):
        fitted = _refit(fitted, board_mm[used], uv[used])
        error = np.linalg.norm(fitted.image(board_mm) - uv, axis=1)
        spread = MAD * np.median(error[used])
        used = error < max(5.0 * spread, 0.05)
        if used.sum() < MIN_POINTS:
            return None
    determinants = np.linalg.det(fitted.jacobian(board_mm[used]))
    if not (np.isfinite(determinants).all() and determinants.min() > 0):
        return None
    return fitted, used


def _refit(start: BoardMap, board_mm: Float64[Array, "n 2"], uv: Float64[Array, "n 2"]) -> BoardMap:
    terms = 10 if len(uv) >= _CUBIC_POINTS else 6 if len(uv) >= _QUADRATIC_POINTS else 0
    ideal = uv + monomials((uv - start.centre_px) / start.scale_px) @ start.to_ideal
    homography = homography_of(board_mm, ideal)
    ideal = _project(homography, board_mm)
    return BoardMap(
        ideal_from_board=homography,
        to_ideal=fit_polynomial((uv - start.centre_px) / start.scale_px, ideal - uv, terms),
        to_distorted=fit_polynomial((ideal - start.centre_px) / start.scale_px, uv - ideal, terms),
        centre_px=start.centre_px,
        scale_px=start.scale_px,
    )


def fit_polynomial(xy: Float64[Array, "n 2"], values: Float64[Array, "n 2"], terms: int) -> Float64[Array, "10 2"]:
    """Fit the first `terms` monomials by Huber-weighted least squares (three rounds)."""
    coefficients = np.zeros((10, 2))
    if terms == 0:
        return coefficients
    design = monomials(xy)[:, :terms]
    weight = np.ones(len(xy))
    for _ in range(3):
        weighted = design * weight[:, None]
        normal = weighted.T @ design
        normal[np.diag_indices(terms)] += _RIDGE * len(xy)
        coefficients[:terms] = np.linalg.solve(normal, weighted.T @ values)
        error = np.linalg.norm(design @ coefficients[:terms] - values, axis=1)
        limit = 1.5 * MAD * np.median(error) + 1e-9
        weight = np.minimum(1.0, limit / np.maximum(error, 1e-12))
    return coefficients


def _project(homography: Float64[Array, "3 3"], points: Float64[Array, "*n 2"]) -> Float64[Array, "*n 2"]:
    homogeneous = points @ homography[:, :2].T + homography[:, 2]
    return homogeneous[..., :2] / homogeneous[..., 2:]


def homography_of(board_mm: Float64[Array, "n 2"], ideal: Float64[Array, "n 2"]) -> Float64[Array, "3 3"]:
    """Least-squares homography by the normalised direct linear transform (Hartley)."""
    (from_board, board), (from_ideal, image) = _normalised(board_mm), _normalised(ideal)
    one, zero = np.ones(len(board)), np.zeros((len(board), 3))
    points = np.column_stack([board, one])
    rows = np.concatenate(
        [
            np.column_stack([points, zero, -image[:, :1] * points]),
            np.column_stack([zero, points, -image[:, 1:] * points]),
        ]
    )
    _, vectors = np.linalg.eigh(rows.T @ rows)
    homography = np.linalg.inv(from_ideal) @ vectors[:, 0].reshape(3, 3) @ from_board
    return homography / homography[2, 2]


def _normalised(points: Float64[Array, "n 2"]) -> tuple[Float64[Array, "3 3"], Float64[Array, "n 2"]]:
    centre = points.mean(axis=0)
    scale = float(np.abs(points - centre).max()) or 1.0
    matrix = np.array([[1 / scale, 0, -centre[0] / scale], [0, 1 / scale, -centre[1] / scale], [0, 0, 1]])
    return matrix, (points - centre) / scale


def monomials(xy: Float64[Array, "*n 2"]) -> Float64[Array, "*n 10"]:
    """1, x, y, x², xy, y², x³, x²y, xy², y³."""
    x, y = xy[..., 0], xy[..., 1]
    one = np.ones_like(x)
    return np.stack([one, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y], axis=-1)
