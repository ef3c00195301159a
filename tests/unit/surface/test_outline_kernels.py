"""Silhouettes' contours, against scikit-image."""

import numpy as np
from scipy import ndimage
from skimage.measure import find_contours

from mammometry.surface.fusion import field_kernels as outline_kernels


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
