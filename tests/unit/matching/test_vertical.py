"""The vertical disparity's field: what is estimated of it, and when it is applied."""

import numpy as np
from scipy import ndimage

from mammometry.matching.dense.vertical_disparity import VerticalField, refine

HEIGHT, WIDTH = 120, 160


def texture(seed: int = 3) -> np.ndarray:
    """Band-limited noise, so that resampling by a cubic spline is exact to thousandths."""
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH))
    return ndimage.gaussian_filter(noise, 2.0).astype(np.float32)


def shifted_down(image: np.ndarray, rows: float) -> np.ndarray:
    """The picture as a camera sees it whose rows are off by a constant."""
    return ndimage.shift(image, (rows, 0), order=5, mode="nearest").astype(np.float32)


def test_a_constant_vertical_disparity_is_found_in_one_step() -> None:
    left = texture()
    right = shifted_down(left, 0.3)  # seen 0.3 px lower on the right: v_left − v_right = −0.3
    coefficients = ndimage.spline_filter1d(right, order=3, axis=1, mode="mirror", output=np.float32)
    inside = np.zeros(left.shape, dtype=bool)
    inside[6:-6, 6:-6] = True
    found = refine(VerticalField(size_wh=(WIDTH, HEIGHT)), left, coefficients, np.zeros_like(left), inside, level=0)
    columns = np.broadcast_to(np.arange(WIDTH, dtype=np.float32), left.shape)
    np.testing.assert_allclose(
        found.at(columns, 0)[inside], -0.3, rtol=0.07
    )  # one linear step: the rest is second order
    assert found.matters(0)


def test_steep_skin_tells_nothing() -> None:
    left = texture()
    coefficients = ndimage.spline_filter1d(left, order=3, axis=1, mode="mirror", output=np.float32)
    steep = np.broadcast_to(0.5 * np.arange(WIDTH, dtype=np.float32), left.shape).copy()
    before = VerticalField(size_wh=(WIDTH, HEIGHT))
    assert refine(before, left, coefficients, steep, np.ones(left.shape, bool), level=0) is before


def test_a_field_that_is_large_only_in_a_corner_is_not_applied() -> None:
    field = VerticalField(size_wh=(WIDTH, HEIGHT))
    columns = np.broadcast_to(np.arange(WIDTH, dtype=np.float32), (HEIGHT, WIDTH))
    terms = [
        term.ravel().astype(np.float64)
        for term in field.terms_at(columns, np.arange(HEIGHT, dtype=np.float32)[:, None], 0)
    ]
    x, y = terms[1], terms[2]
    corner = np.linalg.lstsq(np.stack(terms, axis=1), np.exp(4 * (x + y - 2)), rcond=None)[0]
    uneven = field.changed(corner, terms)
    assert max(np.abs(uneven.limits_px)) > 0.1 > uneven.typical_px
    assert not uneven.matters(0)
    even = field.changed(np.array([0.15, 0, 0, 0, 0, 0]), terms)
    assert even.matters(0)
    assert not even.matters(1), "0.15 px are less than 0.1 of a coarser level's pixels"


def test_a_strip_of_skin_that_is_not_steep_does_not_tell_the_rest() -> None:
    """As on a plate seen at 50°: a quadratic through one edge was −494 px at the other."""
    rng = np.random.default_rng(5)
    columns = np.broadcast_to(np.arange(WIDTH, dtype=np.float64), (HEIGHT, WIDTH))
    rows = np.broadcast_to(np.arange(HEIGHT, dtype=np.float64)[:, None], (HEIGHT, WIDTH))
    shift = 0.3 * np.minimum(columns - 138, 0)
    left = ndimage.map_coordinates(texture(), [rows, columns + shift], order=5, mode="nearest")
    noisy = (left + 0.01 * rng.standard_normal(left.shape)).astype(np.float32)
    right = (texture() + 0.01 * rng.standard_normal(left.shape)).astype(np.float32)
    coefficients = ndimage.spline_filter1d(right, order=3, axis=1, mode="mirror", output=np.float32)
    off = shift + 0.1 * np.sin(rows / 9 + columns / 3)  # what smoothing leaves
    trusted = (columns > 10) & (columns < 150) & (rows > 6) & (rows < HEIGHT - 6)
    field = VerticalField(size_wh=(WIDTH, HEIGHT))
    for _ in range(2):
        field = refine(field, noisy, coefficients, off.astype(np.float32), trusted, level=0)
    assert np.abs(field.coefficients_px).max() < 0.3
