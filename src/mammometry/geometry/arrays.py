"""Array aliases and read-only arrays.

Shapes live in annotations: ``Float64[Array, "n 3"]``; one dimension is written ``" n"``.
The tests check them at run time.
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
"""Any NumPy array. The jaxtyping annotation around it gives shape and dtype."""


def bounds(points: Float64[Array, "n d"]) -> tuple[Float64[Array, " d"], Float64[Array, " d"]]:
    """Lowest and highest coordinates of points.

    Column by column, for a reduction over rows of three values takes ten times as long.
    """
    return np.array([column.min() for column in points.T]), np.array([column.max() for column in points.T])
