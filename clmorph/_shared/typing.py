"""Names for common types, which ``help`` shows in place of unions.

For that, public modules import `annotations` from ``__future__``.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["AnyArray", "Array", "ArrayLike", "BoolArray", "IntArray", "Progress"]

#: An array of float64; shapes are in the docstrings.
Array = NDArray[np.float64]
#: An array of int64.
IntArray = NDArray[np.int64]
#: An array of truth values.
BoolArray = NDArray[np.bool_]
#: An array of any dtype.
AnyArray = NDArray[Any]
#: A function that is called with the share of the work that is done, from 0 to 1.
Progress = Callable[[float], None]
