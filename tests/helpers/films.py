"""Pictures and films as Pillow reads them."""

import numpy as np
from PIL import Image, ImageSequence


def noise(rng, count=5, shape=(12, 16, 3)):
    return list(rng.integers(0, 256, (count, *shape), np.uint8))


def stills(file):
    """The frames of a file, (H, W, 4) each, and their milliseconds."""
    with Image.open(file) as film:
        found = [
            (np.asarray(frame.convert("RGBA")), frame.info.get("duration"))
            for frame in ImageSequence.Iterator(film)
        ]
    return map(list, zip(*found, strict=True))


def frames_of(file):
    return next(stills(file))


def contents(path):
    """The bytes of a file, or of the files of a folder."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return [file.read_bytes() for file in files]
