"""What a mask takes of its picture, against SciPy."""

import numpy as np
from scipy import ndimage

from mammometry.geometry import mesh_kernels


def test_the_extent_is_that_of_all_true_pixels():
    rng = np.random.default_rng(3)
    for share in (0.0, 0.001, 0.01, 0.5, 1.0):
        mask = rng.random((40, 57)) < share
        found = ndimage.find_objects(mask.astype(np.uint8))
        expected = [end for axis in found[0] for end in (axis.start, axis.stop)] if found else [0, 0, 0, 0]
        assert mesh_kernels.extent(mask).tolist() == expected
