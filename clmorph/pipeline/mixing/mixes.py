"""The result `Mixes`: pictures that mix several images by given weights."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.items import Items
from clmorph._shared.notebook import picture
from clmorph._shared.progress import StageProgress
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_integer
from clmorph.backends.interface import Operations
from clmorph.frames.ends import ends_of
from clmorph.frames.mixes import MixRenderer
from clmorph.frames.sequence import Frame
from clmorph.images.detail import is_pixel_art
from clmorph.output.framing import Framing
from clmorph.output.options import FrameStyle
from clmorph.output.playback import eased
from clmorph.output.save import Output
from clmorph.pipeline.guides import Guided
from clmorph.pipeline.mixing.weights import Layout, check_mix_weights, path_weights
from clmorph.pipeline.mixing.writing import Leg, check_outputs, write_film, write_sheet
from clmorph.pipeline.morph import ImagePair
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import Picture
from clmorph.pipeline.recipe import recipe
from clmorph.pipeline.result import Morph


def pairs_of(count: int) -> list[tuple[int, int]]:
    """Return the pairs of images between which mixes are solved, in the order of landmarks."""
    return list(itertools.combinations(range(count), 2))


class _Solved:
    """Morphs that are kept: between images, and the one between two mixes that was used last."""

    def __init__(self) -> None:
        self.morphs: dict[tuple[int, int], Morph] = {}
        self.last: dict[bytes, Morph] = {}


@dataclass(frozen=True, repr=False, eq=False)
class Mixes(Items[Frame]):
    """Pictures that mix several images: a sequence with one picture for each row of `weights`.

    Pictures are drawn on demand, and the transport between two images is solved when the first
    picture needs it. A picture with one positive weight is that image itself, and one with two is
    the frame of the morph of both (`morph`), to the bit.

    Attributes
    ----------
    images : list of (H, W, 3) or (H, W, 4) arrays
        The images at the size at which they are drawn.
    weights : (n, K) array
        Weights of each picture, with the sum 1.
    layout : Layout
        The places of the pictures on `sheet`.
    guide : Guided
        The options, with the landmarks of each pair of images.
    operations : Operations
    shapes : list of (height, width)
        Shapes of the images as they were given.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> images = np.zeros((3, 6, 6, 3))
    >>> images[0, :, :3] = images[1, :3] = images[2, :, 3:] = 1.0
    >>> mixes = clmorph.mix(images, [[0.5, 0.25, 0.25], [0, 1, 0]], backend="numpy")
    >>> len(mixes), mixes[0].shape
    (2, (6, 6, 3))
    >>> bool(np.array_equal(mixes[1], images[1]))
    True
    """

    images: list[Picture]
    layout: Layout
    guide: Guided = field(repr=False)
    operations: Operations = field(repr=False)
    shapes: list[tuple[int, int]]
    progress: StageProgress = field(repr=False)
    _solved: _Solved = field(init=False, default_factory=_Solved, repr=False)

    def __repr__(self) -> str:
        return f"<Mixes of {len(self.images)} images, {len(self)} pictures>"

    def _repr_html_(self) -> str:
        """Show the sheet of all pictures in a notebook."""
        return picture(self.sheet(), repr(self)[1:-1])

    @property
    def options(self) -> MorphOptions:
        """The options of all morphs; of three or more images the landmarks are those of all."""
        return self.guide.options

    @property
    def found(self) -> str:
        """What ``landmarks="auto"`` has found, in a line; "" if nothing."""
        return self.guide.found

    @property
    def weights(self) -> Array:
        """(n, K) weights of each picture, with the sum 1."""
        return self.layout.weights

    def __len__(self) -> int:
        return len(self.weights)

    def _item(self, index: int) -> Frame:
        """Draw the picture with the weights ``weights[index]``."""
        return self.frame(self.layout.weights[index])

    @property
    def clear(self) -> bool:
        """Whether an image has opacity; then all pictures have."""
        return any(image.shape[2] == 4 for image in self.images)

    @property
    def pixelated(self) -> bool:
        """Whether all images are pixel art."""
        return all(is_pixel_art(image) for image in self.images)

    @property
    def carries(self) -> bool:
        """Whether three or more images are mixed by the layers of all pairs, or else by halves."""
        return self.options.detail == "layers"

    def frame(self, weights: ArrayLike) -> Frame:
        """Draw the mix with some weights.

        Parameters
        ----------
        weights : (K,) array
            The weight of each image, at least 0; they are scaled to the sum 1.

        Returns
        -------
        (H, W, 3) or (H, W, 4) float32 array
            sRGB in [0, 1]; with opacity if an image has it. Height and width are the weighted
            means of those of the images.

        Raises
        ------
        InputError
            If the weights cannot be used.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> images = np.zeros((2, 6, 6, 3))
        >>> images[0, :, :3] = images[1, :3] = 1.0
        >>> mixes = clmorph.mix(images, [1, 1], backend="numpy")
        >>> morph = clmorph.morph(*images, backend="numpy")
        >>> bool(np.array_equal(mixes.frame([3, 1]), morph.frame(0.25)))
        True
        """
        return self._drawn(check_mix_weights(weights, len(self.images))[0])

    def morph(self, first: int, second: int) -> Morph:
        """Return the morph between two of the images, by their numbers from 0.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> images = np.zeros((2, 6, 6, 3))
        >>> images[0, :, :3] = images[1, :3] = 1.0
        >>> clmorph.mix(images, [1, 1], backend="numpy").morph(0, 1).frame(0.5).shape
        (6, 6, 3)
        """
        first = check_integer("first", first, 0, len(self.images) - 1)
        second = check_integer("second", second, 0, len(self.images) - 1)
        if (first, second) not in self._solved.morphs:
            pair = ImagePair(
                [self.images[first], self.images[second]], self._options_of(first, second),
                [self.shapes[first], self.shapes[second]],
            )  # fmt: skip
            name = f" {first + 1}-{second + 1}" if len(self.images) > 2 else ""
            self._solved.morphs[first, second] = pair.morph(
                self.operations, lambda stage, share: self.progress(stage + name, share)
            )
        return self._solved.morphs[first, second]

    def _options_of(self, first: int, second: int) -> MorphOptions:
        """Return the options of the morph between two images."""
        pairs = pairs_of(len(self.images))
        if (first, second) in pairs:
            return self.guide.of(pairs.index((first, second)))
        if first == second:
            return self.options.replace(landmarks=None)
        back = self.guide.of(pairs.index((second, first)))
        landmarks: Any = back.landmarks or ()
        return back.replace(landmarks=[pair[::-1] for pair in landmarks] or None)

    def sheet(self, background: str | None = None) -> NDArray[np.uint8]:
        """Return all pictures side by side, those of a grid at their places.

        Parameters
        ----------
        background : str, optional
            Color under transparent parts and around pictures that are smaller than others; by
            default it is transparent if an image has opacity, and else white.

        Returns
        -------
        (H, W, 3) or (H, W, 4) uint8 array

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> images = np.zeros((2, 6, 8, 3))
        >>> clmorph.mix(images, grid=4, backend="numpy").sheet().shape
        (6, 32, 3)
        """
        from PIL import Image

        if background is not None:
            background = FrameStyle.checked("background", background)
        frames = self.drawn()
        style = FrameStyle(background=background or (None if self.clear else "white"))
        framing = Framing(style, [frame.shape for frame in frames], self.pixelated)
        width, height = framing.size
        columns, rows = self.layout.size
        ground = background or ((0, 0, 0, 0) if framing.clear else "white")
        mode = "RGBA" if framing.clear else "RGB"
        sheet = Image.new(mode, (columns * width, rows * height), ground)
        for frame, (left, top) in zip(frames, self.layout.places.tolist(), strict=True):
            framed = framing(np.rint(255 * frame).astype(np.uint8))
            sheet.paste(framed, (round(left * width), round(top * height)))
        return np.asarray(sheet)

    def drawn(self) -> list[Frame]:
        """Draw all pictures, in an order in which neighbors share morphs."""
        found: dict[int, Frame] = {}
        weights = self.weights
        halves = [b"" if self.carries else self._halves(row)[2] for row in weights]
        for done, number in enumerate(sorted(range(len(weights)), key=lambda k: (halves[k], k))):
            found[number] = self._drawn(weights[number])
            self.progress("mixes", (done + 1) / len(weights))
        return [found[number] for number in range(len(weights))]

    def path(self, stops: str | Sequence[ArrayLike]) -> list[Leg]:
        """Return the legs of a path through mixes, for films.

        Parameters
        ----------
        stops : str or sequence of weights
            Letters of images, a for the first one, and "+" for the even mix of all, such as
            "abdca"; or the weights at each stop.

        Returns
        -------
        list of Leg

        Raises
        ------
        InputError
            If a stop cannot be used, or there are fewer than two.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> images = np.zeros((3, 6, 6, 3))
        >>> mixes = clmorph.mix(images, [1, 1, 1], n_frames=3, backend="numpy")
        >>> [len(leg) for leg in mixes.path("ab+")]
        [3, 3]
        """
        weights = path_weights(stops, len(self.images))
        times = eased(np.linspace(0.0, 1.0, self.options.n_frames), self.options.ease)
        return [Leg(self.frame, one, other, times) for one, other in itertools.pairwise(weights)]

    @property
    def parameters(self) -> dict[str, Any]:
        """The recipe of the pictures, as values that `json.dumps` accepts."""
        return self._recipe(None)

    def save(
        self, path: str | PathLike[str], stops: str | Sequence[ArrayLike] | None = None
    ) -> None:
        """Write the sheet of all pictures, or the film of a path through mixes.

        Parameters
        ----------
        path : path
            Path of a PNG file; with `stops` of any film that `clmorph.save` writes.
        stops : str or sequence of weights, optional
            The stops of a path, see `path`. Between two stops there are `n_frames` frames.

        Raises
        ------
        InputError
            If an option or a stop cannot be used.
        OutputError
            If the file cannot be written, or cannot hold mixes.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> import numpy as np
        >>> import clmorph
        >>> mixes = clmorph.mix(np.zeros((2, 6, 6, 3)), n_frames=4, backend="numpy")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     mixes.save(Path(folder) / "row.png")
        ...     mixes.save(Path(folder) / "film.gif", "aba")
        ...     sorted(path.name for path in Path(folder).iterdir())
        ['film.gif', 'row.png']
        """
        outputs = [Output(path)]
        legs = [] if stops is None else self.path(stops)
        check_outputs(outputs, len(legs) + 1 if legs else 0, self.options)
        metadata = self._recipe(legs)
        if legs:
            write_film(outputs, legs, self.options, self.pixelated, metadata, None, self.progress)
        else:
            write_sheet(outputs, self.sheet(self.options.background), metadata)

    def _recipe(self, legs: Sequence[Leg] | None) -> dict[str, Any]:
        """Return the recipe of the pictures, or of a film."""
        shown = {"weights": self.weights.tolist()}
        if legs:
            shown = {"stops": [legs[0].start.tolist(), *(leg.end.tolist() for leg in legs)]}
        return recipe(self.options, device=self.operations.description, mixes=shown)

    def _drawn(self, weights: Array) -> Frame:
        shown = np.flatnonzero(weights).tolist()
        if len(shown) == 1:
            picture: NDArray[np.floating] = self.images[shown[0]]
        elif len(shown) == 2:
            first, second = shown
            picture = self.morph(first, second).frame(float(weights[second]))
        elif self.carries:
            picture = self._renderer.frame(weights.tolist())
        else:
            picture = self._step(weights)
        if self.clear and picture.shape[2] == 3:
            picture = np.dstack((picture, np.ones(picture.shape[:2])))
        return np.clip(picture, 0.0, 1.0).astype(np.float32)

    @cached_property
    def _renderer(self) -> MixRenderer:
        """The renderer of mixes of three and more images."""
        layers = {
            (first, second): self.morph(first, second).layers
            for second in range(len(self.images))
            for first in range(second)
        }
        # In each pair with an image its measure, and its picture, are the same.
        pairs = [self.morph(0, k) for k in range(1, len(self.images))]
        measures = [pairs[0].source, *(pair.target for pair in pairs)]
        ends = [ends_of((pair.source, pair.target), pair.pictures) for pair in pairs]
        pictures = [ends[0][0], *(end for _, end in ends)]
        return MixRenderer(pictures, measures, layers, self.options.path_space, self.operations)

    def _halves(self, weights: Array) -> tuple[Array, Array, bytes]:
        """Return the weights of the mixes of both halves of the images that are shown."""
        shown = np.flatnonzero(weights)
        middle = shown[len(shown) // 2]
        first, second = weights.copy(), weights.copy()
        first[middle:] = second[:middle] = 0.0
        parts = [each / total if (total := each.sum()) else each for each in (first, second)]
        return parts[0], parts[1], np.round(parts, 9).tobytes()

    def _step(self, weights: Array) -> Array:
        """Draw a mix as the frame of a morph between the mixes of both halves of the images."""
        first, second, key = self._halves(weights)
        if key not in self._solved.last:
            ends = [self._drawn(each).astype(np.float64) for each in (first, second)]
            plain = self.options.replace(landmarks=None)
            found = ImagePair(ends, plain).morph(self.operations, self.progress)
            self._solved.last.clear()
            self._solved.last[key] = found
        share = float(weights[second > 0].sum())
        return self._solved.last[key].frame(share).astype(np.float64)
