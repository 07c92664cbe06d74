"""The two images, and the methods by which they are reduced."""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import clmorph
from clmorph.images.pixels import as_rgb

Image = NDArray[np.float64]

#: Columns of the photograph that make it square, as in `clmorph.cli.demo`.
CROP = slice(85, 385)
#: Width of the Gaussian that smooths pictures before they are sampled, in sides, and the pixels
#: that they have at least meanwhile.
SMOOTHNESS, FINE_SIDE = 0.03, 192


@dataclass(frozen=True)
class Pair:
    """Source and target as they were read, at full size.

    Attributes
    ----------
    source, target : (H, W, 3) or (H, W, 4) arrays
    names : (source's, target's)
        For captions.
    bundled : bool
        Whether it is the pair that everybody has.
    """

    source: Image
    target: Image
    names: tuple[str, str]
    bundled: bool = False

    def as_published(self, side: int) -> list[Image]:
        """Return both at side x side, as the published numbers had them."""
        return [resize_as_published(image, side) for image in (self.source, self.target)]

    def fitted(self, *sides: int) -> list[Image]:
        """Return both opaque, reduced to the longer sides given (one, or one each).

        Smaller ones are enlarged block by block as far as they fit.
        """
        each = sides if len(sides) == 2 else sides * 2
        result = []
        for image, side in zip((self.source, self.target), each, strict=True):
            reduced = clmorph.fit(as_rgb(image), side)
            blocks = np.ones((side // max(reduced.shape[:2]),) * 2)
            result.append(np.kron(reduced, blocks[..., None]))
        return result

    def sampled(self, side: int) -> list[Image]:
        """Return both opaque, smoothed, as their means over side x side cells.

        So they are discretizations of one pair of smooth pictures, whatever the side.
        """
        return [_cell_means(_smooth(as_rgb(image)), side) for image in (self.source, self.target)]


def load_pair(source: Path | None, target: Path | None) -> Pair:
    """Read both images; without them the bundled sprite and scikit-image's photograph of a cat."""
    if source is not None and target is not None:
        images = clmorph.read_image(source), clmorph.read_image(target)
        return Pair(*images, (source.name, target.name))
    from skimage.data import chelsea

    with resources.as_file(resources.files("clmorph.cli.samples") / "cat.png") as file:
        sprite = clmorph.read_image(file)
    names = "the bundled sprite (cat.png)", "scikit-image's chelsea"
    return Pair(sprite, chelsea()[:, CROP] / 255.0, names, bundled=True)


def resize_as_published(image: Image, side: int) -> Image:
    """Resize to side x side as the published numbers were made, aliasing included.

    8-bit RGB (opacity dropped), /255 in float32, then bilinear between half-pixel centers, as
    torch's `interpolate(mode="bilinear", align_corners=False)`.
    """
    pixels = np.round(np.asarray(image)[..., :3] * 255).astype(np.float32) / np.float32(255)
    for axis in (0, 1):
        length = pixels.shape[axis]
        step = np.float32(length) / np.float32(side)
        at = np.maximum(step * (np.arange(side, dtype=np.float32) + np.float32(0.5)) - 0.5, 0)
        low = np.minimum(at.astype(np.int64), length - 1)
        high = np.minimum(low + 1, length - 1)
        share = np.expand_dims((at - low).astype(np.float32), 1 - axis)[..., None]
        pixels = (1 - share) * pixels.take(low, axis) + share * pixels.take(high, axis)
    return np.clip(pixels.astype(float), 0.0, 1.0)


def _smooth(image: Image) -> Image:
    """Take away what coarse images cannot show; enlarged first, if it has few pixels."""
    from scipy.ndimage import gaussian_filter

    factor = -(-FINE_SIDE // min(image.shape[:2]))
    image = image.repeat(factor, axis=0).repeat(factor, axis=1)
    widths = [SMOOTHNESS * side for side in image.shape[:2]]
    return gaussian_filter(image, (*widths, 0), mode="nearest")


def _cell_means(image: Image, side: int) -> Image:
    """Average an image, taken as constant on each pixel, over side x side equal cells."""
    for axis in (0, 1):
        length = image.shape[axis]
        cells = np.linspace(0.0, length, side + 1)[:, None]
        pixels = np.arange(length)
        ends = np.minimum(cells[1:], pixels + 1) - np.maximum(cells[:-1], pixels)
        shares = np.maximum(ends, 0.0) * (side / length)
        image = np.moveaxis(np.tensordot(shares, image, (1, axis)), 0, axis)
    return np.clip(image, 0.0, 1.0)
