"""Compiled laying of photographs into a picture, against plain NumPy and SciPy."""

import numpy as np
import pytest
from scipy import ndimage

from mammometry.surface.texture import texture_kernels

LEVEL_STEP = 4


def depths_and_weights(three, pixels):
    """Distance of pixels inside a triangle's nearest side, and barycentric coordinates."""
    weights = np.linalg.solve(np.vstack([three.T, np.ones(3)]), np.vstack([pixels.T, np.ones(len(pixels))])).T
    across = []
    for corner in range(3):  # from the side opposite to it
        start, along = three[corner - 2], three[corner - 1] - three[corner - 2]
        normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
        inward = np.sign((three[corner] - start) @ normal)
        across.append(inward * (pixels - start) @ normal)
    return np.min(across, axis=0), weights


def test_a_pixel_belongs_to_the_triangle_that_it_lies_deepest_in():
    rng = np.random.default_rng(5)
    corners, margin, first, stop, width = rng.uniform(-3, 33, size=(12, 3, 2)), 1.5, 4, 22, 30
    corners[3, 2] = corners[3, 0]  # no area
    triangle, row, column, between = texture_kernels.deepest_triangles(corners, first, stop, width, margin)
    rows, columns = (grid.ravel() for grid in np.mgrid[first:stop, :width])
    pixels = np.stack([columns, rows], axis=1).astype(np.float64)
    deepest, owner = np.full(len(pixels), -np.inf), np.full(len(pixels), -1)
    weights = np.zeros((len(pixels), 3))
    for number, three in enumerate(corners):
        if number == 3:
            continue
        depth, own = depths_and_weights(three, pixels)
        boxed = ((pixels >= three.min(axis=0) - margin) & (pixels <= three.max(axis=0) + margin)).all(axis=1)
        better = (depth >= -margin) & boxed & (depth >= deepest)
        deepest[better], owner[better], weights[better] = depth[better], number, own[better]
    shown = owner >= 0
    assert 100 < shown.sum() < len(pixels)
    np.testing.assert_array_equal(np.stack([row, column]), np.stack([rows, columns])[:, shown])
    np.testing.assert_array_equal(triangle, owner[shown])
    np.testing.assert_allclose(between, weights[shown], atol=1e-4)


def test_shares_are_those_of_the_weights_between_the_corners():
    rng = np.random.default_rng(6)
    weights = rng.uniform(size=(3, 20)).astype(np.float32)
    weights[:, :4] = 0.0
    corners = rng.integers(0, 20, (50, 3)).astype(np.int32)
    corners[0] = 0, 1, 2  # where no weight is left
    between = rng.uniform(-0.1, 1, (50, 3)).astype(np.float32)
    own = rng.integers(0, 3, 50).astype(np.int32)
    found = texture_kernels.shares_of(weights, corners, between, own, 1e-6)
    expected = np.einsum("pc,kpc->kp", np.maximum(between, 0.0), weights[:, corners].astype(np.float64))
    expected[own, np.arange(50)] += 1e-6
    np.testing.assert_allclose(found, expected / expected.sum(axis=0), atol=1e-6)
    assert found[own[0], 0] == 1.0


def means(levels, step):
    """Pixels of step × step recorded ones, 0…1, in three channels."""
    height, width, channels = levels.shape[0] // step, levels.shape[1] // step, levels.shape[2]
    whole = levels[: height * step, : width * step] / np.iinfo(levels.dtype).max
    small = whole.reshape(height, step, width, step, channels).mean(axis=(1, 3))
    return np.repeat(small, 3 // channels, axis=2)


def levelled(level, row, column):
    at = [np.asarray(row) / LEVEL_STEP, np.asarray(column) / LEVEL_STEP]
    return np.stack([ndimage.map_coordinates(level[..., c], at, order=1, mode="nearest") for c in range(3)], axis=-1)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("step", [1, 3])
def test_a_piece_is_the_photographs_own_pixels_levelled(kind, channels, step):
    rng = np.random.default_rng(7)
    levels = rng.integers(0, np.iinfo(kind).max, (65, 94, channels), dtype=kind)
    level = rng.uniform(-0.6, 0.6, (18, 26, 3)).astype(np.float32)
    gain, low, high = np.array([0.9, 1.0, 1.2], dtype=np.float32), np.array([3, 5]), np.array([28, 21])
    scale = float(np.iinfo(kind).max)
    found = texture_kernels.pasted((levels, scale, step), low, high, (gain, level, LEVEL_STEP))
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    expected = gain * means(levels, step)[rows, columns] + levelled(level, rows, columns)
    assert (expected < 0).any()
    assert (expected > 1).any()
    error = np.abs(found - np.clip(expected, 0, 1) * 255)
    assert error.max() <= 0.5 + 1e-3


@pytest.mark.parametrize("step", [1, 3])
def test_a_photograph_is_mixed_in_by_its_shares(step):
    rng = np.random.default_rng(8)
    levels = rng.integers(0, 255, (65, 94, 3), dtype=np.uint8)
    level = rng.uniform(-0.2, 0.2, (18, 26, 3)).astype(np.float32)
    gain = np.array([0.9, 1.0, 1.2], dtype=np.float32)
    uv, corners = rng.uniform(-2, 32, (30, 2)), rng.integers(0, 30, (40, 3)).astype(np.int32)
    between = rng.dirichlet([1, 1, 1], 40).astype(np.float32)
    share = np.where(rng.uniform(size=40) < 0.3, 0.0, rng.uniform(size=40)).astype(np.float32)
    before = rng.uniform(size=(40, 3)).astype(np.float32)
    mixed = before.copy()
    texture_kernels.mix_in(mixed, share, corners, between, uv, (levels, 255.0, step), (gain, level, LEVEL_STEP))
    column, row = np.einsum("pc,pcx->xp", between.astype(np.float64), uv[corners])
    small = means(levels, step)
    at = [row, column]
    colour = np.stack([ndimage.map_coordinates(small[..., c], at, order=1, mode="nearest") for c in range(3)])
    expected = before + share[:, None] * (gain * colour.T + levelled(level, row, column))
    np.testing.assert_allclose(mixed, expected, atol=1e-5)
    np.testing.assert_array_equal(mixed[share == 0], before[share == 0])
