"""Array aliases and read-only arrays.

Shapes live in annotations: ``Float64[Array, "n 3"]``; one dimension is written ``" n"``.
The tests check them at run time.
"""

from typing import TypeAlias, TypeVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, Integer, Shaped, UInt8, UInt16

__all__ = ["Array", "Bool", "Float32", "Float64", "Int32", "Int64", "Integer", "Shaped", "UInt8", "UInt16", "read_only"]

Array: TypeAlias = np.ndarray
"""Any NumPy array. The jaxtyping annotation around it gives shape and dtype."""

_A = TypeVar("_A", bound=np.ndarray)


def read_only(array: _A) -> _A:
    """Return a view of `array` that cannot be written through.

    The data are not copied.
    """
    view = array.view()
    view.flags.writeable = False
    return view
