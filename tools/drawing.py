"""Shared by the tools that draw pictures of the pages: options, and squares of photographs."""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image
from skimage import data


def parser(doc: str, *, optional: bool = False) -> argparse.ArgumentParser:
    """Return a parser of a picture's path, which may be optional, and of the device."""
    made = argparse.ArgumentParser(description=doc.splitlines()[0])
    made.add_argument("output", type=Path, nargs="?" if optional else None)
    made.add_argument("--device", default="auto")
    return made


def square(name: str, cut: tuple[int, int, int], side: int) -> np.ndarray:
    """Return a square of a photograph, `cut` by left, top and width: (side, side, 3) bytes."""
    left, top, width = cut
    whole = getattr(data, name)()[top : top + width, left : left + width]
    return np.asarray(Image.fromarray(whole).resize((side, side), Image.Resampling.LANCZOS))
