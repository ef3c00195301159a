"""A textured ball before a textured plane, cast ray by ray in closed form, as two converging cameras see it."""

from dataclasses import dataclass

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform

SIZE_WH = (320, 240)
RADIUS_MM, AWAY_MM = 110.0, 800.0


def rig() -> Rig:
    """Two cameras, 200 mm apart, that look at the origin from AWAY_MM; it is the ball's centre."""
    cameras = {}
    for name, x_mm in (("one_left", -100.0), ("one_right", 100.0)):
        centre = np.array([x_mm, 0.0, -np.sqrt(AWAY_MM**2 - x_mm**2)])
        ahead = -centre / np.linalg.norm(centre)
        right = np.cross([0.0, 1.0, 0.0], ahead)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(ahead, right), ahead])
        cameras[name] = Camera(
            name=name,
            size_wh=SIZE_WH,
            matrix=np.array([[600.0, 0.0, 159.5], [0.0, 600.0, 119.5], [0.0, 0.0, 1.0]]),
            distortion=np.zeros(5),
            camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
        )
    return Rig(name="two", cameras=cameras, pair_names={"one": ("one_left", "one_right")})


@dataclass(frozen=True)
class Look:
    """Colour, encoded, and the relative contrast of its texture."""

    rgb: tuple[float, float, float]
    contrast: float


def photograph(
    camera: Camera, plane_z_mm: float, ball: Look, behind: Look, *, seed: int = 0
) -> tuple[Photograph, np.ndarray]:
    """The picture, with noise, and where it shows the ball: true to whole pixels.

    Args:
        camera: one of the rig.
        plane_z_mm: of a plane z = constant, world frame: larger is farther away.
        ball: how it looks.
        behind: how the plane looks.
        seed: of texture and noise.
    """
    width, height = SIZE_WH
    uv = np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=2)
    rays, origin = camera.rays_world(uv), camera.centre_world
    along = -(rays @ origin)
    missed_by = origin @ origin - along**2
    hit = missed_by < RADIUS_MM**2
    to_ball = along - np.sqrt(np.where(hit, RADIUS_MM**2 - missed_by, 0.0))
    to_plane = (plane_z_mm - origin[2]) / rays[..., 2]
    hit &= to_ball < to_plane
    points = origin + np.where(hit, to_ball, to_plane)[..., None] * rays
    rng = np.random.default_rng(seed)
    pattern = np.zeros((height, width))
    for _ in range(24):
        wave = rng.normal(size=3)
        wave *= 2 * np.pi / (rng.uniform(8.0, 60.0) * np.linalg.norm(wave))
        pattern += np.sqrt(2 / 24) * np.cos(points @ wave + rng.uniform(0, 2 * np.pi))
    noise = np.random.default_rng([seed, camera.name.endswith("left")]).normal(0.0, 0.006, (height, width, 3))
    colour = np.where(hit[..., None], np.array(ball.rgb), np.array(behind.rgb))
    contrast = np.where(hit, ball.contrast, behind.contrast)
    encoded = colour * (1 + contrast * pattern)[..., None] + noise
    pixels = np.clip(np.rint(255 * encoded), 0, 255).astype(np.uint8)
    return Photograph(name=f"capture/{camera.name}.png", pixels=pixels), hit
