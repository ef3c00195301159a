"""A rectified pair in closed form: an analytic texture seen through a known smooth disparity."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.matching.rectify import RectifiedPair


@dataclass(frozen=True)
class Texture:
    """A sum of plane waves: its value is known everywhere, not on a grid only."""

    waves: np.ndarray
    """(n, 2), rad per pixel."""
    phases: np.ndarray
    amplitudes: np.ndarray

    @classmethod
    def random(cls, rng: np.random.Generator, *, shortest_px: float, longest_px: float, contrast: float) -> "Texture":
        """Waves of every direction, lengths between the two, standard deviation `contrast`."""
        length = np.exp(rng.uniform(np.log(shortest_px), np.log(longest_px), 150))
        angle = rng.uniform(0, 2 * np.pi, 150)
        waves = 2 * np.pi / length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        amplitudes = np.full(150, contrast * np.sqrt(2 / 150))
        return cls(waves=waves, phases=rng.uniform(0, 2 * np.pi, 150), amplitudes=amplitudes)

    def at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Value at the positions."""
        total = np.zeros(np.broadcast(u, v).shape)
        for (a, b), phase, amplitude in zip(self.waves, self.phases, self.amplitudes, strict=True):
            total += amplitude * np.cos(a * u + b * v + phase)
        return total


def camera(name: str, size_wh: tuple[int, int], x_mm: float) -> Camera:
    """An ideal camera at (x, 0, 0) that looks along z."""
    width, height = size_wh
    return Camera(
        name=name,
        size_wh=size_wh,
        matrix=np.array([[1000.0, 0.0, width / 2], [0.0, 1000.0, height / 2], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=np.eye(3), translation_mm=np.array([-x_mm, 0.0, 0.0])),
    )


def true_disparity(u: np.ndarray, v: np.ndarray, size_wh: tuple[int, int]) -> np.ndarray:
    """Dome and slope as functions of the *right* image's position, px: a few pixels, gradients up to .1."""
    x, y = 2 * u / size_wh[0] - 1, 2 * v / size_wh[1] - 1
    return 6.0 * (x * x + 0.7 * y * y) + 3.0 * x - 2.0


def make_pair(
    rng: np.random.Generator,
    *,
    size_wh: tuple[int, int] = (220, 180),
    noise: float = 0.004,
    gain: float = 1.0,
    offset: float = 0.0,
    d_v_px: float | Callable[[np.ndarray, np.ndarray], np.ndarray] = 0.0,
    contrast: float = 0.05,
) -> tuple[RectifiedPair, np.ndarray]:
    """The pair, and its true disparity at the left image's pixels.

    The texture lives on the right image; the left one shows at (u, v) what lies there at (u − d, v − d_v), where d is
    `true_disparity` at the right position (found by fixed-point iteration, d's slope being well below 1). `d_v_px` is a
    constant, or a function of the right position's column and the left one's row.
    """
    width, height = size_wh
    texture = Texture.random(rng, shortest_px=5.0, longest_px=40.0, contrast=contrast)
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    right = 0.5 + texture.at(u, v)
    disparity = np.zeros_like(u)
    for _ in range(60):
        disparity = true_disparity(u - disparity, v, size_wh)
    d_v = d_v_px(u - disparity, v) if callable(d_v_px) else d_v_px
    left = 0.5 + offset + gain * texture.at(u - disparity, v - d_v)
    images = [(image + rng.normal(0, noise, image.shape)).astype(np.float32) for image in (left, right)]
    disc = (u - width / 2) ** 2 / (0.42 * width) ** 2 + (v - height / 2) ** 2 / (0.42 * height) ** 2 < 1
    pair = RectifiedPair(
        name="synthetic",
        left=camera("left", size_wh, 0.0),
        right=camera("right", size_wh, 100.0),
        left_image=images[0],
        right_image=images[1],
        left_mask=disc,
        right_mask=disc.copy(),
    )
    return pair, disparity
