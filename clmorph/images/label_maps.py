"""Label images: one integer for each pixel, from arrays and from files, and at another size."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.printable import reason_of
from clmorph._shared.typing import Array, IntArray
from clmorph._shared.validation import check_max_pixels, is_path, shown
from clmorph.backends.arrays import as_array
from clmorph.errors import FileError, InputError
from clmorph.images.pixels import MAX_PIXELS

#: Largest number of different labels of a pair of images: each is a problem of its own.
MAX_LABELS = 256
#: Colors that are no gray have labels from here on: this number, plus red, green and blue as one
#: number of 24 bits.
COLORED = 1 << 24
#: Modes of Pillow whose samples are labels, as gray levels or indices of a palette.
_SCALAR = ("1", "L", "P", "I", "I;16", "I;16B", "I;16L", "I;16N")


def as_labels(name: str, value: Any, shape: tuple[int, int]) -> IntArray:
    """Return a label image of its picture's shape as int64 (H, W), or raise InputError."""
    if is_path(value):
        raise InputError(
            f"{name} is a path: expected an array; use clmorph.read_labels({shown(value)})"
        )
    array = as_array(name, value, "integer labels (H, W)")
    if array.dtype.kind not in "iub":
        raise InputError(
            f"{name} has dtype {array.dtype}: expected integers or bool, one label each"
        )
    if array.shape != shape:
        raise InputError(
            f"{name} has shape {array.shape}: expected {shape}, that of its picture as it is given"
        )
    if array.dtype.kind == "u" and array.dtype.itemsize == 8 and array.max() > np.iinfo(int).max:
        raise InputError(f"{name} has labels up to {array.max()}: expected at most {2**63 - 1}")
    return np.asarray(array, np.int64)


def label_text(label: int) -> str:
    """Return a label for messages: a number, or a color such as '#ff8000'."""
    colored = COLORED <= label < 2 * COLORED
    return f"#{label - COLORED:06x}" if colored else str(label)


def owners(shape: tuple[int, int], reduced: tuple[int, int]) -> IntArray:
    """Return the pixel of a reduced image in which each pixel's center lies: (H, W) indices."""
    row, column = (
        np.minimum(np.int64((np.arange(side) + 0.5) * (small / side)), small - 1)
        for side, small in zip(shape, reduced, strict=True)
    )
    return np.asarray(row[:, None] * reduced[1] + column)


def reduced_labels(labels: IntArray, shape: tuple[int, int]) -> IntArray:
    """Return labels (H, W) at a smaller size: the most frequent, or least, one of each pixel."""
    if labels.shape == shape:
        return labels
    names, index = np.unique(labels, return_inverse=True)
    keys, counts = np.unique(
        owners((labels.shape[0], labels.shape[1]), shape).ravel() * len(names) + index.ravel(),
        return_counts=True,
    )
    pixel, label = np.divmod(keys, len(names))
    order = np.lexsort((-label, counts, pixel))  # the last of each pixel is the most frequent
    found = np.empty(shape[0] * shape[1], np.int64)
    found[pixel[order]] = names[label[order]]
    return found.reshape(shape)


def reduced_values(values: Array, shape: tuple[int, int]) -> Array:
    """Return numbers (H, W, K) at a smaller size, by their mean in each pixel."""
    if values.shape[:2] == shape:
        return values
    own = owners((values.shape[0], values.shape[1]), shape).ravel()
    count = shape[0] * shape[1]
    sizes = np.bincount(own, minlength=count)
    planes = values.reshape(len(own), -1).T
    means = [np.bincount(own, plane, count) / sizes for plane in planes]
    return np.stack(means, axis=-1).reshape(*shape, -1)


def read_labels(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> IntArray:
    """Read a label image.

    Parameters
    ----------
    path : path
        A picture without loss, such as PNG: its gray levels or the indices of its palette are the
        labels. In a picture in color each color is a label; a gray one is that of its level. Or a
        ``.npy`` of integers.
    max_pixels : int
        Largest number of pixels; a larger image raises an error before it is decoded.

    Returns
    -------
    (H, W) array of int64

    Raises
    ------
    InputError
        If an argument is no path, or no number of pixels.
    FileError
        If the file cannot be read, is partly transparent, or has more than 256 labels.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from PIL import Image
    >>> import clmorph
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "labels.png"
    ...     Image.fromarray(np.array([[0, 7]], np.uint8)).save(file)
    ...     clmorph.read_labels(file).tolist()
    [[0, 7]]
    """
    if not is_path(path):
        raise InputError(f"path={shown(path)}: expected the path of a label image")
    check_max_pixels(max_pixels)
    file = Path(path)
    try:
        samples = _samples(file, max_pixels)
    except InputError:
        raise
    except Exception as error:  # decoders raise exceptions of any class
        raise FileError(f"{file}: labels cannot be read ({reason_of(error)})") from None
    if samples.ndim == 3:
        if samples.shape[2] != 3 or samples.dtype != np.uint8:
            raise FileError(
                f"{file} holds an array of shape {samples.shape}: expected labels (H, W)"
            )
        red, green, blue = (samples[..., k].astype(np.int64) for k in range(3))
        gray = (red == green) & (green == blue)
        samples = np.where(gray, red, COLORED + (red << 16 | green << 8 | blue))
    if samples.ndim != 2 or not samples.size or samples.dtype.kind not in "iub":
        raise FileError(
            f"{file} holds {samples.dtype} of shape {samples.shape}: expected integers (H, W)"
        )
    found = np.unique(samples)
    if len(found) > MAX_LABELS:
        raise FileError(
            f"{file} has {len(found)} different labels: expected at most {MAX_LABELS}; draw them "
            "without smoothing, and save them as PNG, not as JPEG"
        )
    return np.asarray(samples, np.int64)


def _samples(file: Path, max_pixels: int) -> Any:
    """Return the samples of a file as they stand there."""
    from clmorph.images.reading import tiff
    from clmorph.images.reading.boxes import Reader
    from clmorph.images.reading.opening import open_picture

    if file.suffix.lower() == ".npy":
        return read_npy(file, max_pixels)
    with Reader(file) as stream:
        if stream.read(4) in tiff.SIGNATURES:
            # Labels have no light, so their numbers may be signed.
            samples = tiff.read_tiff(file, max_pixels, signed=True).samples
            if samples.shape[2] in (2, 4):
                opacity = samples[..., -1]
                if opacity.dtype.kind == "u" and opacity.min() < np.iinfo(opacity.dtype).max:
                    raise _transparent(file)
                samples = samples[..., :-1]
            return samples[..., 0] if samples.shape[2] == 1 else samples
    with Reader(file) as stream, open_picture(file, stream, max_pixels) as picture:
        if picture.mode in _SCALAR and "transparency" not in picture.info:
            return np.asarray(picture)
        pixels = np.asarray(picture.convert("RGBA"))
        if np.any(pixels[..., 3] < 255):
            raise _transparent(file)
        if picture.mode in _SCALAR:  # an index that no pixel has is transparent
            return np.asarray(picture)
        return pixels[..., :3]


def read_npy(file: Path, max_pixels: int) -> Any:
    """Return the array of a ``.npy`` file of at most `max_pixels` rows times columns."""
    with file.open("rb") as stream:
        version = 1 if np.lib.format.read_magic(stream) == (1, 0) else 2
        read = getattr(np.lib.format, f"read_array_header_{version}_0")
        shape, _, dtype = read(stream)
        if dtype.hasobject:
            raise ValueError("it holds Python objects, which are not read")
        if int(np.prod(shape[:2], dtype=object)) > max_pixels or len(shape) > 3:
            raise FileError(f"{file} has shape {shape}: expected at most {max_pixels} pixels")
        if int(np.prod(shape, dtype=object)) * dtype.itemsize > file.stat().st_size:
            raise ValueError("it is shorter than its header says")
        stream.seek(0)
        return np.lib.format.read_array(stream, allow_pickle=False)


def _transparent(file: Path) -> FileError:
    return FileError(
        f"{file} is transparent in parts, which have no label: save it without opacity"
    )
