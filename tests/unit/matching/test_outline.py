"""The outline of a cast in a photograph, against discs of known radius, blurred and shaded."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from mammometry.matching.foreground.contour import edge_places, outline
from mammometry.matching.foreground.foreground import Foreground

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
def test_neither_blur_nor_brightness_moves_the_outline(blur_px: float, brightness: float) -> None:
    """A Gaussian blur of σ moves a disc's edge inwards by σ² / 2 r; the grid does not resolve one of half a pixel."""
    disc = np.linalg.norm(offsets(), axis=-1) < RADIUS
    found = outline(photographed(brightness * disc, blur_px))
    radius = np.linalg.norm(found.uv - CENTRE, axis=1)
    assert len(found.uv) > 200
    assert radius.mean() == pytest.approx(RADIUS - blur_px**2 / (2 * RADIUS), abs=0.08 if blur_px < 1 else 0.06)
    assert radius.std() < 0.06  # sampling on the pixel grid


@pytest.mark.parametrize("share", [0.4, 0.7])
@pytest.mark.parametrize("depth_px", [1.0, 2.0, 4.0])
def test_a_rim_that_darkens_towards_its_edge_does_not_move_it(share: float, depth_px: float) -> None:
    """Its half level would lie up to .5 px inside; .06 px of what is left is the grid of tried shapes."""
    inside = RADIUS - np.linalg.norm(offsets(), axis=-1)
    rim = (inside > 0) * (1 - (1 - share) * np.exp(-np.maximum(inside, 0) / depth_px))
    found = outline(photographed(rim, 0.8))
    radius = np.linalg.norm(found.uv - CENTRE, axis=1)
    assert radius.mean() == pytest.approx(RADIUS - 0.8**2 / (2 * RADIUS), abs=0.06)


def test_the_common_level_would_be_moved_by_both() -> None:
    disc = np.linalg.norm(offsets(), axis=-1) < RADIUS
    shaded = photographed(0.6 * disc, 2.5)
    at_level = np.sqrt(np.count_nonzero(shaded.mask) / np.pi)
    assert abs(at_level - RADIUS) > 0.5


@pytest.mark.slow
@settings(max_examples=40)
@given(
    place=st.floats(-0.8, 0.8),
    share=st.floats(0.5, 1.0),
    sigma=st.floats(0.6, 1.1),
    bright=st.floats(0.1, 2.0),
    unit=st.floats(0.5, 8.0),
)
@example(place=0.796875, share=0.75, sigma=1.0625, bright=1.0, unit=1.0)
def test_edges_lie_where_profiles_were_cut_off(
    place: float, share: float, sigma: float, bright: float, unit: float
) -> None:
    """Profiles summed up from a cut-off exponential, point by point; everything scales with the unit.

    As along a contour, which crosses the pixels at all distances, the places are spread over several of those tried.
    A darker edge further out looks much like a brighter one further in, and an outline chooses its blur and depth by
    the misfits at tried places: a lone profile's choice depends on how near to one its edge lies, and its place may be
    .2 units off. The tried shapes leave .03 units of standard deviation, .13 at worst for a blur midway between two.
    """
    x = np.arange(-3.5, 4.76, 0.25) * unit
    fine = np.arange(-9, 12, 0.01) * unit
    places = (place + np.linspace(-0.2, 0.2, 11)) * unit
    inside = fine - places[:, None]
    light = bright * (inside > 0) * (1 - (1 - share) * np.exp(-np.maximum(inside, 0) / (2 * sigma * unit)))
    spread = np.exp(-((x[:, None] - fine) ** 2) / (2 * (sigma * unit) ** 2))
    profiles = light @ spread.T / spread.sum(axis=1)
    assert edge_places(profiles, x, unit) == pytest.approx(places, abs=0.1 * unit)


def test_a_profile_without_a_step_has_no_edge() -> None:
    """A straight slope, and nothing at all."""
    x = np.arange(-3.5, 4.76, 0.25)
    assert np.isnan(edge_places(np.stack([0.1 * (x + 4), np.zeros_like(x)]), x, 1.0)).all()


def test_the_border_of_a_shadow_is_left_out() -> None:
    """The disc's lower quarter lies in a shadow with a border 12 px wide, which the silhouette follows."""
    away = offsets()
    lit = np.clip((25.0 - away[..., 1]) / 12, 0, 1)
    found = outline(photographed((np.linalg.norm(away, axis=-1) < RADIUS) * lit, 0.7))
    radius = np.linalg.norm(found.uv - CENTRE, axis=1)
    assert len(found.uv) > 150
    assert np.abs(radius - RADIUS).max() < 1.0


def test_nothing_seen_has_no_outline() -> None:
    assert len(outline(photographed(np.zeros((650, 650)), 1.0)).uv) == 0
