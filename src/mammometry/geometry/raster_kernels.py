"""Compiled kernels on pixel grids.

The mesh face nearest to the viewer, whose twin in the tests is a ray caster; what a mask takes of its picture.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64

_SLACK = 1e-9
"""Slack of a barycentric weight: no pixel falls between two faces that share an edge."""


@kernel
def nearest_faces(
    corners: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], height: int, width: int
) -> tuple[Int32[Array, "h w"], Float32[Array, "h w 3"], Float32[Array, "h w"]]:
    """Face at the middle of each pixel, its weights and position.

    The face is −1 where there is none. Weights are those of its corners. Position is towards the viewer. `corners` has
    column, row and position towards the viewer of every vertex. The middle of the first pixel is at 0, 0. Both sides
    of a face are seen. −∞ is as far from the viewer as where there is no face.
    """
    nearest = np.full((height, width), -1, dtype=np.int32)
    weights = np.zeros((height, width, 3), dtype=np.float32)
    towards = np.full((height, width), -np.inf, dtype=np.float32)
    for face in range(len(faces)):
        a, b, c = corners[faces[face, 0]], corners[faces[face, 1]], corners[faces[face, 2]]
        first, last = max(np.ceil(min(a[1], b[1], c[1])), 0.0), min(np.floor(max(a[1], b[1], c[1])), height - 1.0)
        left, right = max(np.ceil(min(a[0], b[0], c[0])), 0.0), min(np.floor(max(a[0], b[0], c[0])), width - 1.0)
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0 or first > last or left > right:
            continue
        for row in range(int(first), int(last) + 1):
            for column in range(int(left), int(right) + 1):
                of_b = ((column - a[0]) * (c[1] - a[1]) - (row - a[1]) * (c[0] - a[0])) / area
                of_c = ((b[0] - a[0]) * (row - a[1]) - (b[1] - a[1]) * (column - a[0])) / area
                of_a = 1.0 - of_b - of_c
                if of_a < -_SLACK or of_b < -_SLACK or of_c < -_SLACK:
                    continue
                height_mm = of_a * a[2] + of_b * b[2] + of_c * c[2]
                if height_mm > towards[row, column]:
                    towards[row, column] = height_mm
                    nearest[row, column] = face
                    weights[row, column, 0] = of_a
                    weights[row, column, 1] = of_b
                    weights[row, column, 2] = of_c
    return nearest, weights, towards


@kernel
def extent(mask: Bool[Array, "h w"]) -> Int64[Array, " 4"]:
    """First and last row and column with a true pixel.

    Each end is one further. Rows first. Zeros where there is none.
    """
    height, width = mask.shape
    box = np.zeros(4, dtype=np.int64)
    left, right = width, 0
    for row in range(height):
        first = 0
        while first < width and not mask[row, first]:
            first += 1
        if first == width:
            continue
        last = width - 1
        while last >= right and not mask[row, last]:
            last -= 1
        if right == 0:
            box[0] = row
        box[1] = row + 1
        left, right = min(left, first), max(right, last + 1)
    if right > 0:
        box[2], box[3] = left, right
    return box
