"""Rigid transforms, named by their frames: ``c_from_a = c_from_b @ b_from_a``."""

from __future__ import annotations

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64

_PROPER_TOLERANCE = 1e-6  # tolerance of R Rᵀ: 0.001 mm at a distance of 1 m


@value(eq=False)
class Transform:
    """A rotation followed by a translation.

    ``x_b = rotation @ x_a + translation``, mm.

    Raises:
        ValueError: the rotation is not orthonormal with determinant +1 within 1e-6, or a value is not finite.
    """

    rotation: Float64[Array, "3 3"]
    translation_mm: Float64[Array, 3]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rotation).all() and np.isfinite(self.translation_mm).all()):
            raise ValueError(f"transform has values that are not finite: {self.rotation}, {self.translation_mm}")
        error = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if error > _PROPER_TOLERANCE or np.linalg.det(self.rotation) < 0:
            raise ValueError(
                f"not a proper rotation: R Rᵀ differs from the identity by {error:.2g}, "
                f"determinant {np.linalg.det(self.rotation):.6f}, expected +1"
            )

    @classmethod
    def identity(cls) -> Transform:
        """Return the identity."""
        return cls(rotation=np.eye(3), translation_mm=np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: Float64[Array, "4 4"]) -> Transform:
        """Convert a homogeneous 4 × 4 matrix. Its last row must be 0 0 0 1."""
        if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0)):
            raise ValueError(f"the last row of a rigid transform must be 0 0 0 1, found {matrix[3]}")
        return cls(rotation=matrix[:3, :3].copy(), translation_mm=matrix[:3, 3].copy())

    @classmethod
    def from_rotation_vector(cls, rotation_rad: Float64[Array, 3], translation_mm: Float64[Array, 3]) -> Transform:
        """Build from a rotation vector (axis times angle, Rodrigues), rad, and a translation, mm."""
        from scipy.spatial.transform import Rotation

        return cls(rotation=Rotation.from_rotvec(rotation_rad).as_matrix(), translation_mm=np.asarray(translation_mm))

    @property
    def matrix(self) -> Float64[Array, "4 4"]:
        """The homogeneous 4 × 4 matrix."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation_mm
        return matrix

    @property
    def rotation_vector_rad(self) -> Float64[Array, 3]:
        """Rotation vector: axis times angle, rad."""
        from scipy.spatial.transform import Rotation

        vector: Float64[Array, 3] = Rotation.from_matrix(self.rotation).as_rotvec()
        return vector

    def inverse(self) -> Transform:
        """Return ``a_from_b`` for ``b_from_a``."""
        return Transform(rotation=self.rotation.T.copy(), translation_mm=-self.rotation.T @ self.translation_mm)

    def __matmul__(self, other: Transform) -> Transform:
        return Transform(
            rotation=self.rotation @ other.rotation,
            translation_mm=self.rotation @ other.translation_mm + self.translation_mm,
        )

    def apply(self, points: Float64[Array, "*n 3"]) -> Float64[Array, "*n 3"]:
        """Transform points (…, 3), mm, from frame a to frame b."""
        return points @ self.rotation.T + self.translation_mm

    def rotate(self, directions: Float64[Array, "*n 3"]) -> Float64[Array, "*n 3"]:
        """Rotate directions (…, 3) from frame a to frame b."""
        return directions @ self.rotation.T
