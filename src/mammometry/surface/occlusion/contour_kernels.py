"""Compiled kernel: the pieces of a silhouette's contour.

Its plain twin stands in tests/unit/surface/test_outline_kernels.py.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64

# Of a square's four sides top, right, bottom and left, those that the contour enters and leaves by, the subject on one
# side of it: for each of its corners' 16 cases, up to two pieces. −1 for none.
_TOP, _RIGHT, _BOTTOM, _LEFT, _NONE = 0, 1, 2, 3, -1
_PIECES = np.array(
    [
        [_NONE, _NONE, _NONE, _NONE],
        [_TOP, _LEFT, _NONE, _NONE],
        [_RIGHT, _TOP, _NONE, _NONE],
        [_RIGHT, _LEFT, _NONE, _NONE],
        [_LEFT, _BOTTOM, _NONE, _NONE],
        [_TOP, _BOTTOM, _NONE, _NONE],
        [_RIGHT, _TOP, _LEFT, _BOTTOM],
        [_RIGHT, _BOTTOM, _NONE, _NONE],
        [_BOTTOM, _RIGHT, _NONE, _NONE],
        [_TOP, _LEFT, _BOTTOM, _RIGHT],
        [_BOTTOM, _TOP, _NONE, _NONE],
        [_BOTTOM, _LEFT, _NONE, _NONE],
        [_LEFT, _RIGHT, _NONE, _NONE],
        [_TOP, _RIGHT, _NONE, _NONE],
        [_LEFT, _TOP, _NONE, _NONE],
        [_NONE, _NONE, _NONE, _NONE],
    ]
)


@kernel
def contour_pieces(
    coverage: Float32[Array, "h w"], window: Int64[Array, " 4"], holes: Bool[Array, "H W"], step: int, level: float
) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2"]]:
    """Straight pieces of the contours at a level.

    One or two for each square of four pixels that they pass. Row and column of each piece's start, and its way to its
    end, in steps from the window's first pixel. As skimage.measure.find_contours, in no order.

    Args:
        coverage: of each pixel.
        window: first and last row and column, each end one further, in which contours are wanted.
        holes: of every `step`-th pixel of the window: pixels beside it count as covered.
        step: pixels a step.
        level: of the contour.
    """
    starts, steps = np.empty((1024, 2)), np.empty((1024, 2))
    count = 0
    sides = np.empty((4, 2))
    for row in range(window[1] - window[0] - 1):
        for column in range(window[3] - window[2] - 1):
            upper_left = coverage[window[0] + row, window[2] + column]
            upper_right = coverage[window[0] + row, window[2] + column + 1]
            lower_left = coverage[window[0] + row + 1, window[2] + column]
            lower_right = coverage[window[0] + row + 1, window[2] + column + 1]
            case = _case(upper_left, upper_right, lower_left, lower_right, level)
            if case == 15:
                continue
            if holes[row // step, column // step]:
                upper_left = np.float32(1.0)
            if holes[row // step, (column + 1) // step]:
                upper_right = np.float32(1.0)
            if holes[(row + 1) // step, column // step]:
                lower_left = np.float32(1.0)
            if holes[(row + 1) // step, (column + 1) // step]:
                lower_right = np.float32(1.0)
            case = _case(upper_left, upper_right, lower_left, lower_right, level)
            sides[_TOP, 0], sides[_TOP, 1] = row, column + _share(upper_left, upper_right, level)
            sides[_BOTTOM, 0], sides[_BOTTOM, 1] = row + 1, column + _share(lower_left, lower_right, level)
            sides[_LEFT, 0], sides[_LEFT, 1] = row + _share(upper_left, lower_left, level), column
            sides[_RIGHT, 0], sides[_RIGHT, 1] = row + _share(upper_right, lower_right, level), column + 1
            for piece in range(2):
                start, end = _PIECES[case, 2 * piece], _PIECES[case, 2 * piece + 1]
                if start < 0 or (sides[start, 0] == sides[end, 0] and sides[start, 1] == sides[end, 1]):
                    continue
                if count == len(starts):
                    starts, steps = _longer(starts), _longer(steps)
                for axis in range(2):
                    starts[count, axis] = sides[start, axis] / step
                    steps[count, axis] = sides[end, axis] / step - sides[start, axis] / step
                count += 1
    return starts[:count].copy(), steps[:count].copy()


@kernel
def _case(upper_left, upper_right, lower_left, lower_right, level):  # type: ignore[no-untyped-def]
    case = 0
    if upper_left > level:
        case += 1
    if upper_right > level:
        case += 2
    if lower_left > level:
        case += 4
    if lower_right > level:
        case += 8
    return case


@kernel
def _share(start, end, level):  # type: ignore[no-untyped-def]
    """Share of the way from one value to another at which the level is reached."""
    if end == start:
        return 0.0
    return (level - np.float64(start)) / (np.float64(end) - np.float64(start))


@kernel
def _longer(rows: Float64[Array, "n 2"]) -> Float64[Array, "2n 2"]:
    longer = np.empty((2 * len(rows), 2))
    for row in range(len(rows)):
        longer[row, 0], longer[row, 1] = rows[row, 0], rows[row, 1]
    return longer
