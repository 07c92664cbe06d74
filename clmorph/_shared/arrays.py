"""Conversion of callers' arguments to arrays of numbers, in one way everywhere.

Every value from which NumPy can make an array is accepted: lists, arrays of any order and byte
order, read-only arrays, data frames, tensors on the host. Values that NumPy could convert only with
a loss (masked entries, imaginary parts, texts, sparse matrices) raise an error that names the
remedy.
"""

from typing import Any

import numpy as np

from clmorph._shared.printable import printable
from clmorph._shared.typing import AnyArray, Array
from clmorph._shared.validation import as_float
from clmorph.errors import InputError

#: Kinds of dtypes (see `numpy.dtype.kind`) that count as numbers: bool, integers, floats.
NUMBERS = "biuf"


def as_array(name: str, value: Any, expected: str = "an array of numbers") -> AnyArray:
    """Return a value as an array of numbers, with its own dtype, in this machine's byte order.

    Parameters
    ----------
    name : str
        The name of the value in error messages.
    value : array_like
    expected : str
        The description of the expected value in error messages.

    Returns
    -------
    array of bool, integers or floats
        It can share memory with `value`.

    Raises
    ------
    InputError
        If the value is no array of real numbers, or one of its entries is masked.
    """
    if hasattr(value, "getbands") and getattr(value, "mode", "RGB") not in _PLAIN_MODES:
        raise InputError(
            f"{name} is a Pillow image of mode {value.mode!r}, whose values are not RGB: convert "
            "it with .convert('RGBA'), or use clmorph.read_image"
        )
    if isinstance(value, str | bytes | bytearray | dict | set | frozenset):
        raise _no_array(name, value, expected)
    if hasattr(value, "tocoo") and hasattr(value, "toarray"):
        raise InputError(
            f"{name} is a sparse matrix: expected {expected}; make it dense with .toarray()"
        )
    if _is_masked(value):
        raise InputError(
            f"{name} has masked entries: expected {expected}, all of them given; replace them "
            "with .filled(value)"
        )
    try:
        array = np.asarray(value)
    except Exception as error:
        # Foreign types can raise any exception; tensors in a device's memory do, for example.
        ragged = isinstance(value, list | tuple) and isinstance(error, ValueError)
        reason = "its rows differ in length" if ragged else printable(str(error), 120)
        raise InputError(
            f"{name} is not an array of numbers ({reason}): expected {expected}"
        ) from None
    if array.dtype.kind == "O":
        array = _from_objects(name, array, value, expected)
    if array.dtype.kind not in NUMBERS:
        raise InputError(f"{name} has dtype {printable(array.dtype)}: expected {expected}")
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def as_floats(name: str, value: Any, expected: str = "an array of numbers") -> Array:
    """Return a value as a new array of float64, in C order; see `as_array`.

    Numbers beyond the range of float64 become infinite.
    """
    with np.errstate(over="ignore"):
        return np.array(as_array(name, value, expected), dtype=np.float64, order="C", subok=False)


#: Pillow's modes whose values are luma alone, or red, green and blue.
_PLAIN_MODES = ("1", "L", "RGB", "RGBA", "F", "I;16", "I;16L", "I;16B", "I;16N")


def _is_masked(value: Any, depth: int = 0) -> bool:
    """Return whether an entry of the value, or of an array in a list of arrays, is masked."""
    if isinstance(value, np.ma.MaskedArray):
        return bool(np.any(np.ma.getmaskarray(value)))
    if not isinstance(value, list | tuple) or depth > _DEEPEST:
        return False
    nested = (part for part in value if isinstance(part, _MAY_HOLD_MASKS))
    return any(_is_masked(part, depth + 1) for part in nested)


_MAY_HOLD_MASKS = (list, tuple, np.ma.MaskedArray)
#: Largest number of dimensions of NumPy's arrays.
_DEEPEST = 64


def _from_objects(name: str, array: AnyArray, value: Any, expected: str) -> AnyArray:
    """Return an array of Python objects as floats, if all of them are numbers."""
    if array.ndim == 0 and as_float(array.item()) is None:
        raise _no_array(name, value, expected)
    numbers = np.empty(array.shape)
    for index, entry in np.ndenumerate(array):
        number = float(entry) if isinstance(entry, bool | np.bool_) else as_float(entry)
        if number is None:
            what = printable(type(entry).__name__)
            raise InputError(f"{name} holds a {what}: expected {expected}")
        numbers[index] = number
    return numbers


def _no_array(name: str, value: Any, expected: str) -> InputError:
    what = printable(type(value).__name__)
    return InputError(f"{name} is a {what}, which is no array of numbers: expected {expected}")
