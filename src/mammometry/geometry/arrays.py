"""Array aliases, and rounding of values to their noise.

Annotations state shapes: ``Float64[Array, "n 3"]``; one dimension is written ``" n"``. The tests check them at run
time. Values with fewer binary digits compress better on disk (docs/decisions/0039).
"""

from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, Integer, Shaped, UInt8, UInt16

from mammometry.base.value import read_only

__all__ = [
    "Array", "Bool", "Float32", "Float64", "Int32", "Int64", "Integer", "Shaped", "UInt8", "UInt16", "bounds",
    "read_only",
]  # fmt: skip

Array: TypeAlias = np.ndarray
"""Any NumPy array. The jaxtyping annotation around it states shape and dtype."""


def bounds(points: Float64[Array, "n d"]) -> tuple[Float64[Array, " d"], Float64[Array, " d"]]:
    """Lowest and highest coordinates of points.

    Column by column, since a reduction over rows of three values takes ten times as long.
    """
    return np.array([column.min() for column in points.T]), np.array([column.max() for column in points.T])


SIGMA_BITS = 5
"""Binary digits of a standard deviation after the first: a relative error of 1.6 %."""
_MANTISSA_BITS = 23  # of a float32's mantissa


def to_step(values: Float32[Array, "*n"], step: float) -> Float32[Array, "*n"]:
    """Round to the nearest multiple of a step, a power of two, in place.

    The error is at most half a step. Zeros are positive. NaN stays NaN.

    Returns:
        The same array.
    """
    values *= np.float32(1.0 / step)
    np.rint(values, out=values)
    values *= np.float32(step)
    values += np.float32(0.0)
    return values


def to_bits(values: Float32[Array, "*n"], bits: int) -> Float32[Array, "*n"]:
    """Round each value to `bits` binary digits after the first, in place.

    The relative error is at most 2^-(bits + 1). Infinity and NaN stay as they are.

    Returns:
        The same array.
    """
    dropped = _MANTISSA_BITS - bits
    digits = values.view(np.uint32)
    digits += np.uint32(1 << (dropped - 1))
    digits &= np.uint32(0xFFFFFFFF ^ ((1 << dropped) - 1))
    return values
