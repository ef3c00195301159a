"""Increase the standard deviations of a walk's range data near the edges of the data.

The matching windows of a rig end at the subject's outline. The outline is not known in a walk, so matching windows at
the edge of the skin also contain the room, the board or other skin behind it, and the matched points are too deep.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mammometry.geometry import StereoPair
from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.range_image import MAX_SIGMA_MM, RangeImage

_AT_EDGE_PX = 1.0
"""Standard deviation of disparities at the edge, pixels of the range image: 0.9 to 1.1 on virtual walks. With 2, so
much skin is left out that borders move by up to 10 % of a volume (decision 52)."""
_DECAY_PX = 8.0
"""Distance over which it decreases by a factor of e, pixels: about three σ of the matching window."""


def with_edge_errors(image: RangeImage, pair: StereoPair) -> RangeImage:
    """Increase the standard deviations near the edges, and remove data that become too uncertain.

    A pixel of disparity moves a datum of range r and depth z by r z / (f b), with the rectified focal length f and the
    baseline b. The edge of the image counts as an edge.

    Args:
        image: range data of the pair.
        pair: its cameras.
    """
    inside_px = image_kernels.distance_px(np.pad(~image.valid, 1, constant_values=True))[1:-1, 1:-1]
    rows, columns = np.nonzero(image.valid)
    matrix, range_mm = image.camera.matrix, image.range_mm[image.valid].astype(np.float64)
    x, y = (columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]
    depth_mm = range_mm / np.sqrt(1.0 + x**2 + y**2)
    baseline_mm = float(np.linalg.norm(pair.right.centre_world - pair.left.centre_world))
    edge_px = _AT_EDGE_PX * np.exp(-inside_px[image.valid] / _DECAY_PX)
    sigma_mm = image.sigma_mm.copy()
    sigma_mm[image.valid] = np.hypot(
        sigma_mm[image.valid], edge_px * range_mm * depth_mm / (matrix[0, 0] * baseline_mm)
    )
    return replace(image, sigma_mm=sigma_mm).keeping(sigma_mm <= MAX_SIGMA_MM)
