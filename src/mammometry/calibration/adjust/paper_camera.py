"""The paper's camera and ours in its terms (paper 2.2).

Its eleven parameters are C = [α β γ X₀ Y₀ Z₀ x₀ y₀ f μ ν]. The paper says neither in which order its angles turn nor
what its two distortion terms multiply. Ours turn about the axes of the world, x first, then y, then z (R = R_z(γ)
R_y(β) R_x(α)), and the terms are Brown's first two radial ones.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from mammometry.geometry import Array, Camera, Float64, Transform


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperCamera:
    """A camera by the paper's eleven parameters."""

    alpha_rad: float
    """First turn, about the world's x axis."""
    beta_rad: float
    """Second turn, about its y axis. Between −π/2 and π/2."""
    gamma_rad: float
    """Third turn, about its z axis."""
    x_mm: float
    """Perspective centre, world."""
    y_mm: float
    z_mm: float
    x0_px: float
    """Principal point. Integers at pixel centres."""
    y0_px: float
    f_px: float
    """Focal length, the same along both axes."""
    mu: float
    """Radial distortion: x_distorted = x (1 + μ r² + ν r⁴), with x = X / Z, r² = x² + y². Brown's k1."""
    nu: float
    """Brown's k2."""

    @classmethod
    def of(cls, camera: Camera) -> PaperCamera | None:
        """The camera's eleven parameters. None where it has more: another focal length along y, p1, p2 or k3."""
        f_px, fy_px = float(camera.matrix[0, 0]), float(camera.matrix[1, 1])
        if f_px != fy_px or np.any(camera.distortion[2:]):
            return None
        alpha, beta, gamma = _angles(camera.camera_from_world.rotation)
        x_mm, y_mm, z_mm = camera.centre_world.tolist()
        mu, nu = camera.distortion[:2].tolist()
        return cls(
            alpha_rad=alpha,
            beta_rad=beta,
            gamma_rad=gamma,
            x_mm=x_mm,
            y_mm=y_mm,
            z_mm=z_mm,
            x0_px=float(camera.matrix[0, 2]),
            y0_px=float(camera.matrix[1, 2]),
            f_px=f_px,
            mu=mu,
            nu=nu,
        )

    def camera(self, name: str, size_wh: tuple[int, int]) -> Camera:
        """The same camera as ours, with what the eleven parameters lack."""
        rotation = _turn(2, self.gamma_rad) @ _turn(1, self.beta_rad) @ _turn(0, self.alpha_rad)
        return Camera(
            name=name,
            size_wh=size_wh,
            matrix=np.array([[self.f_px, 0.0, self.x0_px], [0.0, self.f_px, self.y0_px], [0.0, 0.0, 1.0]]),
            distortion=np.array([self.mu, self.nu, 0.0, 0.0, 0.0]),
            camera_from_world=Transform(
                rotation=rotation, translation_mm=-rotation @ np.array([self.x_mm, self.y_mm, self.z_mm])
            ),
        )

    def as_table(self) -> dict[str, float]:
        """Names and values, in the paper's order."""
        return asdict(self)


def _turn(axis: int, angle_rad: float) -> Float64[Array, "3 3"]:
    """Rotation about a coordinate axis."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[one, one] = rotation[other, other] = np.cos(angle_rad)
    rotation[other, one] = np.sin(angle_rad)
    rotation[one, other] = -np.sin(angle_rad)
    return rotation


def _angles(rotation: Float64[Array, "3 3"]) -> tuple[float, float, float]:
    """α, β, γ.

    Where β is a right angle and only γ ∓ α is determined, γ is what rounding makes it, and α fits it.
    """
    gamma = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    beta = float(np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0])))
    rest = _turn(2, -gamma) @ rotation  # R_y(β) R_x(α): its middle row is 0, cos α, −sin α
    return float(np.arctan2(-rest[1, 2], rest[1, 1])), beta, gamma
