"""Silhouettes' extent and contours, against NumPy and scikit-image."""

import numpy as np
from scipy import ndimage
from skimage.measure import find_contours

from mammometry.surface import outline_kernels


def test_the_extent_is_that_of_all_true_pixels():
    rng = np.random.default_rng(3)
    for share in (0.0, 0.001, 0.01, 0.5, 1.0):
        mask = rng.random((40, 57)) < share
        found = ndimage.find_objects(mask.astype(np.uint8))
        expected = [end for axis in found[0] for end in (axis.start, axis.stop)] if found else [0, 0, 0, 0]
        assert outline_kernels.extent(mask).tolist() == expected


def test_pieces_are_those_of_find_contours_with_holes_closed():
    rng = np.random.default_rng(5)
    coverage = ndimage.gaussian_filter(rng.random((60, 80)), 2).astype(np.float32)
    coverage = (coverage - coverage.min()) / np.ptp(coverage)
    step, level = 2, 0.5
    holes = rng.random((25, 30)) < 0.1
    window = np.array([4, 54, 6, 66])
    starts, steps = outline_kernels.contour_pieces(coverage, window, holes, step, level)
    filled = np.where(holes.repeat(step, 0).repeat(step, 1), np.float32(1), coverage[4:54, 6:66])
    lines = [line / step for line in find_contours(filled, level)]
    expected = np.concatenate([np.column_stack([line[:-1], np.diff(line, axis=0)]) for line in lines])
    found = np.column_stack([starts, steps])
    assert len(found) > 100
    assert sorted(map(tuple, found)) == sorted(map(tuple, expected))
