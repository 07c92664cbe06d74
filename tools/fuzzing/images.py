"""Damaged image files quickly give an array in [0, 1], or an error of clmorph in one line."""

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageFile

from clmorph import ImageWarning, read_image
from clmorph.errors import FileError
from fuzzing.mutations import mutated
from fuzzing.samples import samples

#: What files are read with: small, so that a mutated size is either refused or soon done.
MAX_PIXELS = 1 << 20
#: Seconds of processor time that one file may take.
PATIENCE = 2.0
#: Characters that a message may have.
LONGEST = 1000
NAMES = ("a.png", "a", "a.tif", "a.jpg", "a.tga", "a b\x1b[31m\n.gif", "ä\udcff.webp")


def shared() -> tuple[Any, ...]:
    """Return what all of a process shares, and no read may change."""
    return (
        Image.MAX_IMAGE_PIXELS, ImageFile.LOAD_TRUNCATED_IMAGES, ImageFile.MAXBLOCK,
        id(warnings.filters), tuple(warnings.filters), warnings.showwarning,
        tuple(np.geterr().items()), Path.cwd(),
    )  # fmt: skip


class Target:
    """Cases of this kind, whose files are made in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.samples = list(samples())

    def case(self, rng: np.random.Generator) -> tuple[str, bytes, Callable[[], list[str]]]:
        """Return what is tried, the offending input if it offends, and what tries it."""
        name, data = self.samples[rng.integers(len(self.samples))]
        other = self.samples[rng.integers(len(self.samples))][1]
        made = mutated(rng, data, other)
        ending = "a.tga" if name.startswith("TGA") else NAMES[rng.integers(len(NAMES))]
        strict = rng.random() < 0.2
        return name, made, lambda: self.read(made, ending, strict)

    def read(self, data: bytes, name: str, strict: bool) -> list[str]:
        """Read a file, and return what is wrong with that."""
        file = self.folder / name
        file.write_bytes(data)
        found: list[str] = []
        with warnings.catch_warnings(record=not strict) as notes:
            warnings.simplefilter("error" if strict else "always")
            before, began = shared(), time.process_time()
            message = ""
            try:
                pixels = read_image(file, max_pixels=MAX_PIXELS)
            except FileError as error:
                message = str(error)
            except ImageWarning as error:  # as was asked for
                message = str(error)
            except Exception as error:
                # Only floats outside of [0, 1] are told by a function for arrays.
                message = str(error)
                if "holds" not in message or type(error).__name__ != "InputError":
                    found.append(f"{type(error).__name__}: {error}")
            else:
                found += _faults(pixels)
            taken = time.process_time() - began
            if shared() != before:
                found.append("what the process shares is changed")
        told = [str(note.message) for note in notes or () if note.category is ImageWarning]
        for text in (message, *told):
            if not text.isprintable() or len(text) > LONGEST:
                found.append(f"not one printable line: {text!r}")
        if "does not fit into memory" in message:
            found.append("too much memory")
        if taken > PATIENCE:
            found.append(f"{taken:.1f} s of processor time")
        return found


def _faults(pixels: np.ndarray) -> list[str]:
    """Return what is wrong with an array."""
    if pixels.dtype != np.float64 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        return [f"an array of shape {pixels.shape} and dtype {pixels.dtype}"]
    if not pixels.size or pixels.shape[0] * pixels.shape[1] > MAX_PIXELS:
        return [f"an array of shape {pixels.shape}"]
    if not np.all((pixels >= 0) & (pixels <= 1)):
        return ["values outside of [0, 1]"]
    return []
