"""A blurred picture's finest levels are empty, whatever noise is in them; a sharp one's are not."""

import numpy as np
import pytest
from scipy import ndimage

from mammometry.matching.dense.least_squares import choose_levels
from mammometry.matching.noise import empty_levels

WHOLE = np.ones((512, 512), dtype=bool)


def skin(blur_px: float, noise: float = 0.003) -> np.ndarray:
    """Texture whose power falls with the square of the frequency, as of skin, blurred, with noise."""
    rng = np.random.default_rng(4)
    along = np.fft.fftfreq(len(WHOLE))
    radius = np.maximum(np.hypot(along[:, None], along), 1 / len(WHOLE))
    pattern = np.fft.ifft2(np.fft.fft2(rng.normal(size=WHOLE.shape)) / radius).real
    picture = 0.5 + 0.05 * ndimage.gaussian_filter(pattern / pattern.std(), blur_px, mode="wrap")
    return (picture + rng.normal(0.0, noise, WHOLE.shape)).astype(np.float32)


@pytest.mark.parametrize(("blur_px", "empty"), [(0.5, 0), (1.6, 1), (3.5, 1), (8.0, 2)])
@pytest.mark.parametrize("noise", [0.0005, 0.006])
def test_a_blur_empties_the_finest_levels(blur_px: float, empty: int, noise: float) -> None:
    assert empty_levels(skin(blur_px, noise), WHOLE) == empty


def test_nothing_is_told_of_a_small_subject() -> None:
    mask = np.zeros_like(WHOLE)
    assert empty_levels(skin(3.0), mask) == 0
    mask[200:216, 200:216] = True
    assert empty_levels(skin(3.0), mask) == 0


def test_empty_levels_are_not_matched_unless_the_subject_gets_too_small() -> None:
    def finest(span_px: int, empty: int) -> tuple[int, int]:
        levels = choose_levels("front", [np.ones((span_px, span_px), bool)] * 2, empty=empty)
        return levels.last_both, levels.finest

    assert finest(500, 0) == (0, 0)
    assert finest(500, 1) == (1, 1)
    assert finest(500, 3) == (1, 1)
    assert finest(2000, 0) == (2, 1)
    assert finest(2000, 3) == (3, 3)
