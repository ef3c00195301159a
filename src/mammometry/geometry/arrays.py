"""Array aliases and read-only arrays.

Shapes live in annotations: ``Float64[Array, "n 3"]``; one dimension is written ``" n"``.
The tests check them at run time.
"""

from typing import TypeAlias, TypeVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, Integer, Shaped, UInt8, UInt16

__all__ = [
    "Array", "Bool", "Float32", "Float64", "Int32", "Int64", "Integer", "Shaped", "UInt8", "UInt16", "bounds",
    "read_only",
]  # fmt: skip

Array: TypeAlias = np.ndarray
"""Any NumPy array. The jaxtyping annotation around it gives shape and dtype."""

_A = TypeVar("_A", bound=np.ndarray)


def read_only(array: _A) -> _A:
    """Return a view of `array` that cannot be written through. The data are not copied."""
    view = array.view()
    view.flags.writeable = False
    return view


def bounds(points: Float64[Array, "n d"]) -> tuple[Float64[Array, " d"], Float64[Array, " d"]]:
    """Lowest and highest coordinates of points.

    Column by column, for a reduction over rows of three values takes ten times as long.
    """
    return np.array([column.min() for column in points.T]), np.array([column.max() for column in points.T])
