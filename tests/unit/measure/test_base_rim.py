"""The outline of a cast in a photograph, against discs of known radius, blurred and shaded."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mammometry.matching.foreground import Foreground
from mammometry.measure.base_rim import outline
from mammometry.measure.settings import BaseRimSettings

EXACT = BaseRimSettings(edge_share=0.5)  # an even disc has no dark rim
CENTRE, RADIUS = np.array([70.3, 64.7]), 40.0


def offsets() -> np.ndarray:
    """Of every pixel of a picture from the disc's middle, each split in 5 × 5."""
    steps = np.arange(0, 130, 0.2) - 0.4
    u, v = np.meshgrid(steps, steps)
    return np.stack([u, v], axis=-1) - CENTRE


def photographed(radiance: np.ndarray, blur_px: float) -> Foreground:
    """The coverage of a picture with 5 × 5 samples a pixel."""
    seen = gaussian_filter(radiance.reshape(130, 5, 130, 5).mean(axis=(1, 3)), blur_px)
    return Foreground(camera="c", coverage=seen.astype(np.float32), contour_level=0.4, everything=False)


@pytest.mark.parametrize("blur_px", [0.5, 1.0, 2.5])
@pytest.mark.parametrize("brightness", [0.6, 1.0])
def test_neither_blur_nor_shade_moves_the_outline(blur_px: float, brightness: float) -> None:
    """A Gaussian blur of σ moves the half level of a disc inwards by σ² / 2 r, .08 px at most."""
    disc = np.linalg.norm(offsets(), axis=-1) < RADIUS
    found = outline(photographed(brightness * disc, blur_px), EXACT)
    radius = np.linalg.norm(found.uv - CENTRE, axis=1)
    assert len(found.uv) > 200
    # 1.75 σ inside it a profile is at 96 %: that lowers the plateau by about 1 % and the edge by .02 σ.
    assert radius.mean() == pytest.approx(RADIUS - blur_px**2 / (2 * RADIUS), abs=0.03 + 0.02 * blur_px)
    assert radius.std() < 0.06  # sampling on the pixel grid


def test_the_common_level_would_be_moved_by_both() -> None:
    disc = np.linalg.norm(offsets(), axis=-1) < RADIUS
    shaded = photographed(0.6 * disc, 2.5)
    at_level = np.sqrt(np.count_nonzero(shaded.mask) / np.pi)
    assert abs(at_level - RADIUS) > 0.5


def test_a_share_below_half_lies_outside_by_the_blur() -> None:
    """An edge blurred by a Gaussian passes 45 % at Φ⁻¹(.45) = −.126 σ."""
    disc = np.linalg.norm(offsets(), axis=-1) < RADIUS
    half, less = (outline(photographed(disc * 1.0, 1.5), BaseRimSettings(edge_share=share)) for share in (0.5, 0.45))
    radii = [np.linalg.norm(found.uv - CENTRE, axis=1).mean() for found in (half, less)]
    assert radii[1] - radii[0] == pytest.approx(0.126 * 1.5, abs=0.03)


def test_the_border_of_a_shadow_is_left_out() -> None:
    """The disc's lower quarter lies in a shadow with a border 12 px wide, which the silhouette follows."""
    away = offsets()
    lit = np.clip((25.0 - away[..., 1]) / 12, 0, 1)
    found = outline(photographed((np.linalg.norm(away, axis=-1) < RADIUS) * lit, 0.7), EXACT)
    radius = np.linalg.norm(found.uv - CENTRE, axis=1)
    assert len(found.uv) > 150
    assert np.abs(radius - RADIUS).max() < 1.0


def test_nothing_seen_has_no_outline() -> None:
    assert len(outline(photographed(np.zeros((650, 650)), 1.0)).uv) == 0
