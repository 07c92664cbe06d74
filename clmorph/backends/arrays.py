"""Convert callers' arguments to arrays of numbers; what would lose values raises an error."""

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from clmorph._shared.printable import printable
from clmorph._shared.typing import AnyArray, Array
from clmorph._shared.validation import as_float
from clmorph.errors import InputError

#: Kinds of dtypes (see `numpy.dtype.kind`) that count as numbers: bool, integers, floats.
NUMBERS = "biuf"


def as_array(name: str, value: Any, expected: str = "an array of numbers") -> AnyArray:
    """Return an array of numbers, with its own dtype, in native byte order; it may share memory."""
    value = _on_host(name, value, expected)
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
    """Return a new float64 array in C order; numbers beyond its range become infinite."""
    with np.errstate(over="ignore"):
        return np.array(as_array(name, value, expected), dtype=np.float64, order="C", subok=False)


def is_of_pyopencl(value: Any) -> bool:
    """Return whether the type of a value, or a base of it, is of pyopencl, without its import."""
    return _is_type_of_pyopencl(type(value))


@contextlib.contextmanager
def pyopencl_needed(name: str) -> Iterator[None]:
    """Raise an `InputError` if pyopencl, which the argument `name` needs, cannot be imported."""
    try:
        yield
    except ImportError as error:
        reason = printable(str(error), 120)
        raise InputError(
            f"{name} needs pyopencl, which cannot be imported ({reason}): install pyopencl, or "
            "use the results in NumPy's arrays"
        ) from None


def _is_type_of_pyopencl(kind: type) -> bool:
    modules = (getattr(base, "__module__", "") for base in kind.__mro__)
    return any(str(module).partition(".")[0] == "pyopencl" for module in modules)


def _on_host(name: str, value: Any, expected: str) -> Any:
    """Return a value that NumPy can convert, in place of one that only other ways can read."""
    if is_of_pyopencl(value):
        from clmorph.backends.opencl.device_arrays import read_in_place

        return read_in_place(name, value, expected)
    if isinstance(value, list | tuple) and any(map(_is_type_of_pyopencl, set(map(type, value)))):
        # NumPy would take each entry of such an array from the device by itself.
        return [_on_host(name, part, expected) for part in value]
    if hasattr(value, "__dlpack__") and not any(hasattr(value, each) for each in _NUMPY_READS):
        return _from_dlpack(name, value, expected)
    return value


#: Attributes by which NumPy itself converts an object.
_NUMPY_READS = ("__array__", "__array_interface__", "__array_struct__")
#: DLPack's device types whose memory the host can read: the host's own, and what CUDA or ROCm have
#: pinned there.
_HOST_TYPES = (1, 3, 11)


def _from_dlpack(name: str, value: Any, expected: str) -> AnyArray:
    """Return an array that shares the memory of an object with ``__dlpack__``."""
    try:
        kind = int(value.__dlpack_device__()[0])
        if kind in _HOST_TYPES:
            return np.from_dlpack(value)
    except Exception as error:
        # Foreign types can raise any exception.
        reason = printable(str(error) or type(error).__name__, 120)
        raise InputError(
            f"{name} cannot be read through DLPack ({reason}): expected {expected}"
        ) from None
    raise InputError(
        f"{name} is in the memory of a device (type {kind} of DLPack): expected {expected}; copy "
        "it to the host first, or give a pyopencl.array.Array"
    )


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
            raise InputError(f"{name} holds a {type(entry).__name__}: expected {expected}")
        numbers[index] = number
    return numbers


def _no_array(name: str, value: Any, expected: str) -> InputError:
    what = type(value).__name__
    return InputError(f"{name} is a {what}, which is not an array of numbers: expected {expected}")
