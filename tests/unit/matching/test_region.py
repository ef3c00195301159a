"""Levels cut to the part of a cluttered scene that is worth matching."""

import numpy as np

from mammometry.matching.dense.crop import cut_levels
from mammometry.matching.pyramid import Level


def test_all_levels_are_cut_alike_and_take_the_masks_of_the_coarsest() -> None:
    """The coarsest one, too: it may be the last that both pictures solve."""
    rng = np.random.default_rng(0)
    shapes = [(23, 30), (12, 15), (6, 8)]
    images = tuple(
        (
            Level(image=rng.random(shape).astype(np.float32), mask=np.ones(shape, bool)),
            Level(image=rng.random(shape).astype(np.float32), mask=np.ones(shape, bool)),
        )
        for shape in shapes
    )
    kept = np.zeros(shapes[-1], bool)
    kept[2:4, 4:7] = True
    window = (slice(1, 6), slice(3, 8))
    cut = cut_levels(images, (kept, np.ones(shapes[-1], bool)), window)
    assert [left.mask.shape for left, _ in cut] == [(19, 18), (10, 9), (5, 5)]
    assert [int(left.mask.sum()) for left, _ in cut] == [96, 24, 6]
    assert all(right.mask.all() for _, right in cut)
    for (left, right), (whole_left, whole_right), step in zip(cut, images, (4, 2, 1), strict=True):
        part = (slice(step, None), slice(3 * step, None))
        np.testing.assert_array_equal(left.image, whole_left.image[part])
        np.testing.assert_array_equal(right.image, whole_right.image[part])
