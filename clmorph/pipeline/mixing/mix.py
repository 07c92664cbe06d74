"""Mix several images by weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np

from clmorph._shared.progress import StageProgress
from clmorph._shared.typing import ArrayLike
from clmorph._shared.validation import check_progress, shown
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.guides import guides
from clmorph.pipeline.keywords import MorphKeywords
from clmorph.pipeline.mixing.mixes import Mixes, pairs_of
from clmorph.pipeline.mixing.weights import MOST_IMAGES, check_mix_weights, grid_layout, row_layout
from clmorph.pipeline.morph import shapes_of
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import as_images, as_options, fitted
from clmorph.pipeline.presets import PresetName


@documented(MorphOptions)
def mix(
    images: Sequence[ArrayLike],
    weights: ArrayLike | None = None,
    options: MorphOptions | None = None,
    *,
    grid: int | tuple[int, int] | None = None,
    preset: PresetName | None = None,
    draft: bool = False,
    backend: Backend = "auto",
    progress: StageProgress | None = None,
    **given: Unpack[MorphKeywords],
) -> Mixes:
    """Mix several images by unbalanced optimal transport.

    The transport is solved between each pair of images that a mix shows together. In a mix with
    the weights w, mass of each image moves towards the weighted mean of its places in all images,
    and takes the weighted mean of its colors there. A mix of one image is that image, and a mix of
    two is a frame of their morph, so the border of a grid shows the morphs between its corners.

    Parameters
    ----------
    images : sequence of arrays
        Two to eight images, see `clmorph.images.pixels.as_pixels`, of any sizes. Each is reduced
        to `size`.
    weights : (K,) or (n, K) array, optional
        The weight of each image in one mix or in each of n mixes, at least 0; they are scaled to
        the sum 1. By default they are those of a grid.
    options : MorphOptions, optional
        All options at once; options given by name replace those of this object.
    grid : int or (rows, columns), optional
        In place of `weights`, the number of mixes along the sides of a grid: a row between two
        images, a triangle between three, a rectangle with bilinear weights between four. 5 by
        default.
    preset, draft
        See `clmorph.morph`. By default all images choose the preset.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.
    progress : callable, optional
        A function that is called with a stage's name and the share of it that is done.
    {options}

    Returns
    -------
    Mixes

    Raises
    ------
    InputError
        If an argument cannot be used.
    DeviceError
        If the device cannot be found or fails.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> images = np.zeros((4, 6, 6, 3))
    >>> images[0, :, :3] = images[1, :3] = images[2, :, 3:] = images[3, 3:] = 1.0
    >>> mixes = clmorph.mix(images, grid=(2, 3), backend="numpy")
    >>> mixes
    <Mixes of 4 images, 6 pictures>
    >>> mixes.weights[1].tolist(), mixes.sheet().shape
    ([0.5, 0.5, 0.0, 0.0], (12, 18, 3))
    """
    several: Any = images
    progress, known = check_progress(progress), isinstance(several, list | tuple)
    if not known and not (isinstance(several, np.ndarray) and several.ndim == 4):
        raise InputError(f"images={shown(images)}: expected a list of two or more images")
    count = len(images)
    if not 2 <= count <= MOST_IMAGES:
        raise InputError(
            f"images: {count} given; expected 2 to {MOST_IMAGES}, because each pair of them is "
            "solved"
        )
    pictures = as_images(list(images))
    if weights is not None and grid is not None:
        raise InputError("weights and grid contradict: give one of them")
    if weights is None:
        layout = grid_layout(count, grid)
    else:
        layout = row_layout(check_mix_weights(weights, count))
    chosen = as_options(options, preset, given, pictures, draft=draft)
    guide = guides(pictures, pairs_of(count), chosen)
    operations = get_backend(backend)
    return Mixes(fitted(pictures, chosen), layout, guide, operations, shapes_of(pictures), progress)
