"""Noise estimated from one picture, against noise that was added. The search starts wider where there is much."""

import numpy as np
from scipy import ndimage
from textured_pair import Texture

from mammometry.matching.dense.least_squares_step import MatchEstimate
from mammometry.matching.noise import checkerboard_residual, noise_variance, unexplained
from mammometry.matching.pyramid import Level, build, decimation
from mammometry.matching.semiglobal import start

SHAPE = (160, 220)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)


def test_the_residual_is_the_plain_convolution() -> None:
    image = np.random.default_rng(1).normal(0, 1, (9, 12)).astype(np.float32)
    kernel = np.outer((1, -2, 1), (1, -2, 1)) / 6
    inner = ndimage.convolve(image, kernel)[1:-1, 1:-1]
    np.testing.assert_allclose(checkerboard_residual(image)[1:-1, 1:-1], inner, atol=1e-5)


def test_noise_is_measured_where_it_is_and_on_the_level_asked_for() -> None:
    """400 windows' worth of pixels: 5 % of a variance, twice that beside the step. A slope and waves add nothing."""
    rng = np.random.default_rng(2)
    deviation = np.where(U < 110, 0.004, 0.012)
    skin = 0.3 + 0.4 * U / SHAPE[1] + Texture.random(rng, shortest_px=9, longest_px=60, contrast=0.03).at(U, V)
    mask = np.hypot((U - 110) / 100, (V - 80) / 70) < 1
    image = np.where(mask, skin, 0.0) + rng.normal(0, 1, SHAPE) * deviation
    finest = Level(image=image.astype(np.float32), mask=mask)
    found = noise_variance(finest, [])
    for part, true in ((U < 90, 0.004), (U > 130, 0.012)):
        assert abs(np.sqrt(found[mask & part].mean()) / true - 1) < 0.1
    grain = build((deviation * rng.normal(0, 1, SHAPE)).astype(np.float32), np.ones(SHAPE, dtype=bool), 0, 2)
    coarse = noise_variance(finest, [decimation(1), decimation(2)])
    assert coarse.shape == grain[2].image.shape
    for columns in (slice(5, 22), slice(33, 50)):
        expected = grain[2].image[5:-5, columns].var()
        assert abs(np.sqrt(coarse[5:-5, columns].mean() / expected) - 1) < 0.2


def test_on_shaded_skin_the_start_looks_wider_than_its_noise() -> None:
    """Contrast of 1.5 times the noise: of 3 × 3 pixels chance makes the most."""
    rng = np.random.default_rng(3)
    texture = Texture.random(rng, shortest_px=8, longest_px=30, contrast=0.008)
    shift = np.rint(4 * np.cos(V / 40))
    mask = np.hypot((U - 110) / 90, (V - 80) / 65) < 1
    images = [texture.at(U, V), texture.at(U - shift, V)]
    left, right = (
        Level(image=(0.2 + image + rng.normal(0, 0.005, SHAPE)).astype(np.float32), mask=mask) for image in images
    )
    noise = noise_variance(left, []), noise_variance(right, [])
    known = start(left, right, noise, 0.1)[0]
    unknown = start(left, right, (0 * noise[0], 0 * noise[1]), 0.1)[0]
    inner = ndimage.binary_erosion(mask, iterations=10)
    missed = [np.mean(np.abs(found - shift)[inner] > 1) for found in (known, unknown)]
    assert missed[0] < 0.04
    assert missed[1] > 3 * missed[0]


def test_a_match_is_doubted_by_what_its_noise_does_not_explain() -> None:
    """With texture s² and noise n² the noise of both pictures leaves 2 n² = (s² + n²) (1 − c²) over."""
    rng = np.random.default_rng(4)
    texture = Texture.random(rng, shortest_px=8, longest_px=20, contrast=0.03).at(U, V)
    image = (0.5 + texture + rng.normal(0, 0.004, SHAPE)).astype(np.float32)
    level = Level(image=image, mask=np.ones(SHAPE, dtype=bool))
    power = float(np.var(image))
    medians = []
    for times in (0.3, 1.0, 3.0, 20.0):
        correlation = np.full(SHAPE, np.sqrt(1 - times * 2 * 0.004**2 / power), dtype=np.float32)
        match = MatchEstimate(
            shift=0 * image, step=0 * image, correlation=correlation, variance=0 * image + 1, plausible=level.mask
        )
        medians.append(float(np.median(unexplained(level, match, 2.5)[20:-20, 20:-20])))
    assert medians[0] == 1.0
    assert medians[1] < 1.3
    assert 1.8 < medians[2] < 4  # windows of 78 pixels hold more or less of the texture
    assert medians[3] == 4.0
