"""The nodes: Morph, Mix, Rearrange, Recolor, Load LUT and Apply LUT.

Their progress, interruption and files are ComfyUI's where it runs. Each is a class with the names
for which ComfyUI asks: ``INPUT_TYPES``, ``RETURN_TYPES``, ``FUNCTION`` and so forth.
"""

import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from clmorph._shared.options import Options
from clmorph._shared.printable import printable
from clmorph._shared.typing import AnyArray
from clmorph.adapters.comfyui import widgets
from clmorph.adapters.comfyui.tensors import (
    as_image_and_mask,
    as_images,
    as_masks,
    has_opacity,
    of_one_size,
    paired,
)
from clmorph.backends.select import get_backend
from clmorph.errors import InputError
from clmorph.frames.sequence import FrameSequence
from clmorph.images.looks import Lut, read_lut
from clmorph.output.options import PlaybackOptions
from clmorph.pipeline.luts import apply_lut
from clmorph.pipeline.mixing.mix import mix
from clmorph.pipeline.morph import morph
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO
from clmorph.pipeline.rearrange import rearrange
from clmorph.pipeline.rearrange_options import RearrangeOptions
from clmorph.pipeline.recipe import digest
from clmorph.pipeline.recolor import recolor
from clmorph.pipeline.recolor_options import RecolorOptions

#: The type of tables of colors in ComfyUI's graphs.
LUT = "CLMORPH_LUT"
#: The names of the inputs for pictures of a mix.
LETTERS = "abcd"
Inputs = dict[str, widgets.Widget]
Item = TypeVar("Item")
#: Steps of the bar for each unit of work.
STEPS = 100
#: Inputs of several nodes, or several inputs of one.
RECOLORED = widgets.image("The pictures to be recolored.")
MASK = widgets.mask("1 where pictures are recolored; other pixels stay.")
TRANSPARENT = widgets.mask("1 where the picture is transparent, as Load Image gives it.")


def input_path(path: str) -> Path:
    """Return a path, from ComfyUI's folder for inputs on if it is relative."""
    folders = sys.modules.get("folder_paths")
    return Path(path) if folders is None else Path(folders.get_input_directory()) / path


class Running:
    """The work of a node, in units: a solve is one, and so is a frame.

    An object is a progress function of clmorph, for the solve that is under way. Each report
    raises ComfyUI's exception if the user has asked to stop.
    """

    def __init__(self, units: int) -> None:
        utils = sys.modules.get("comfy.utils")
        self._bar = None if utils is None else utils.ProgressBar(units * STEPS)
        self._total, self._done, self._shown = units * STEPS, 0, 0
        self._stages: list[str] = []

    def __call__(self, stage: str, share: float) -> None:
        """Show the share of a stage; later stages divide what is left of the unit."""
        if stage not in self._stages:
            self._stages.append(stage)
        rest = 0.5 ** self._stages.index(stage)
        self._show(self._done + int(STEPS * (1.0 - rest * (1.0 - 0.5 * share))))

    def unit(self) -> None:
        """Count one unit of work as done."""
        self._stages.clear()
        self._done += STEPS
        self._show(self._done)

    def each(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield items, each of which is one unit of work."""
        for item in items:
            yield item
            self.unit()

    def _show(self, steps: int) -> None:
        management = sys.modules.get("comfy.model_management")
        if management is not None:
            management.throw_exception_if_processing_interrupted()
        if self._bar is not None and steps > self._shown:
            self._shown = steps
            self._bar.update_absolute(min(steps, self._total), self._total)


class Node:
    """The names that all nodes have in common."""

    CATEGORY = "clmorph"
    FUNCTION = "run"
    REQUIRED: ClassVar[Inputs] = {}
    OPTIONAL: ClassVar[Inputs] = {"device": widgets.DEVICE}
    RETURN_TYPES: ClassVar[tuple[str, ...]] = ("IMAGE", "MASK")
    RETURN_NAMES: ClassVar[tuple[str, ...]] = ("images", "masks")
    OUTPUT_TOOLTIPS: ClassVar[tuple[str, ...]] = (
        "The pictures, with a fourth channel if a picture that was given has one.",
        "1 where the pictures are transparent.",
    )

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Inputs]:  # noqa: N802 (ComfyUI's)
        """Return the inputs."""
        return {"required": cls.REQUIRED, "optional": cls.OPTIONAL}


class NodeWithOptions(Node):
    """A node that takes further options of a class as text."""

    OPTIONS: ClassVar[type[Options]] = MorphOptions
    OPTIONAL: ClassVar[Inputs] = {"options": widgets.OPTIONS, "device": widgets.DEVICE}

    @classmethod
    def VALIDATE_INPUTS(cls, options: str | None = "") -> bool | str:  # noqa: N802
        """Return True, or what is wrong with the options."""
        return widgets.verdict(options, cls.OPTIONS)


class FilmNode(NodeWithOptions):
    """A node that makes the film of each pair of pictures of two batches, or a frame of it."""

    make: ClassVar[Callable[..., FrameSequence]]

    def run(
        self,
        source: Any,
        target: Any,
        frames: int,
        time: float,
        size: int,
        source_mask: Any = None,
        target_mask: Any = None,
        options: str = "",
        device: str = "auto",
        **given: Any,
    ) -> tuple[Any, Any]:
        """Return the frames of all films, one after the other."""
        pairs = paired(
            source=as_images("source", source, source_mask),
            target=as_images("target", target, target_mask),
        )
        running = Running(len(pairs) * (1 + frames))
        given |= {"n_frames": max(frames, 2), "size": size or None}
        given |= widgets.more_options(options, self.OPTIONS)
        operations, made = get_backend(device), list[AnyArray]()
        for one, other in pairs:
            found = self.make(one, other, backend=operations, progress=running, **given)
            running.unit()
            wanted = [time] if frames == 1 else found.times.tolist()
            made += of_one_size(list(running.each(map(found.frame, wanted))), found.pixelated)
        return as_image_and_mask(of_one_size(made), has_opacity(source, target))


class Morph(FilmNode):
    """Morph each picture of a batch into the one of another batch."""

    DESCRIPTION = (
        "Morphs source into target by unbalanced optimal transport: both move and change their "
        "colors along one plan, and one of them is seen at each place. Of two batches each pair "
        "is morphed; a single picture goes with every picture of the other batch."
    )

    REQUIRED: ClassVar[Inputs] = {
        "source": widgets.image("The pictures at the start."),
        "target": widgets.image("The pictures at the end."),
        "frames": widgets.FRAMES,
        "time": widgets.TIME,
        "ease": widgets.option(PlaybackOptions, "ease"),
        "preset": widgets.PRESET,
        "size": widgets.SIZE,
    }
    OPTIONAL: ClassVar[Inputs] = {
        "source_mask": TRANSPARENT,
        "target_mask": TRANSPARENT,
        **NodeWithOptions.OPTIONAL,
    }

    @staticmethod
    def make(*pair: Any, preset: Any, **given: Any) -> FrameSequence:
        """Return a morph."""
        return morph(*pair, preset=None if preset == AUTO else preset, **given)


class Mix(NodeWithOptions):
    """Mix two to four pictures."""

    DESCRIPTION = (
        "Draws pictures between two, three or four pictures: one by their weights, or a grid with "
        "the pictures in its corners (a row, a triangle, a square). Of batches the first pictures "
        "are mixed, the second ones, and so on."
    )

    REQUIRED: ClassVar[Inputs] = {
        **{f"image_{each}": widgets.image(f"Picture {each}.") for each in LETTERS[:2]},
        **{
            f"weight_{each}": widgets.real(
                1.0, 0.0, 1000.0, f"Weight of picture {each}, beside those of the others."
            )
            for each in LETTERS
        },
        "grid": widgets.whole(
            0, 0, 15, "Number of mixes along each side of a grid, in place of the weights; 0: none."
        ),
        "preset": widgets.PRESET,
        "size": widgets.SIZE,
    }
    OPTIONAL: ClassVar[Inputs] = {
        **{f"image_{each}": widgets.image(f"Picture {each}.") for each in LETTERS[2:]},
        **{
            f"image_{each}_mask": widgets.mask(f"1 where picture {each} is transparent.")
            for each in LETTERS
        },
        **NodeWithOptions.OPTIONAL,
    }

    def run(
        self,
        grid: int,
        preset: Any,
        size: int,
        options: str = "",
        device: str = "auto",
        **given: Any,
    ) -> tuple[Any, Any]:
        """Return the mixes of all batches, one after the other."""
        names = [f"image_{each}" for each in LETTERS if given.get(f"image_{each}") is not None]
        batches = {name: as_images(name, given[name], given.get(f"{name}_mask")) for name in names}
        weights = [given[name.replace("image", "weight")] for name in names]
        if grid == 1:
            raise InputError("grid=1: expected 0 for one mix by weights, or 2 and more")
        groups = paired(**batches)
        more: dict[str, Any] = {"preset": None if preset == AUTO else preset, "size": size or None}
        more |= widgets.more_options(options, self.OPTIONS)
        running, operations, made = Running(2 * len(groups)), get_backend(device), []
        for group in groups:
            found = mix(
                list(group), None if grid else weights, grid=grid or None, backend=operations,
                progress=running, **more,
            )  # fmt: skip
            running.unit()
            made += of_one_size(found.drawn(), found.pixelated)
            running.unit()
        opacity = has_opacity(*(given[name] for name in names))
        return as_image_and_mask(of_one_size(made), opacity)


class Rearrange(FilmNode):
    """Move the pixels of a picture so that they form another one."""

    DESCRIPTION = (
        "Moves the pixels of source, each with its own color, so that together they form target. "
        "Every frame has exactly the pixels of source."
    )

    OPTIONS = RearrangeOptions
    make = staticmethod(rearrange)

    REQUIRED: ClassVar[Inputs] = {
        "source": widgets.image("The pictures whose pixels are moved."),
        "target": widgets.image("The pictures that they form."),
        "frames": widgets.FRAMES,
        "time": widgets.TIME,
        "size": widgets.whole(256, *widgets.SIDES, widgets.SIZE[1]["tooltip"]),
        "color_weight": widgets.option(RearrangeOptions, "color_weight"),
    }


class Recolor(NodeWithOptions):
    """Give pictures the colors of others."""

    RETURN_TYPES: ClassVar[tuple[str, ...]] = ("IMAGE",)
    RETURN_NAMES: ClassVar[tuple[str, ...]] = ("images",)
    OUTPUT_TOOLTIPS: ClassVar[tuple[str, ...]] = ("The pictures in their new colors.",)
    DESCRIPTION = (
        "Gives images the colors of like, by transport between their distributions of color. One "
        "map is made for the whole batch, of the colors of all its pictures, so that frames of a "
        "film do not flicker; every picture of like counts."
    )

    OPTIONS = RecolorOptions

    REQUIRED: ClassVar[Inputs] = {
        "images": RECOLORED,
        "like": widgets.image("The pictures that have the colors."),
        **{
            name: widgets.option(RecolorOptions, name)
            for name in ("strength", "color_space", "blur", "feather")
        },
    }
    OPTIONAL: ClassVar[Inputs] = {"mask": MASK, **NodeWithOptions.OPTIONAL}

    def run(
        self,
        images: Any,
        like: Any,
        mask: Any = None,
        options: str = "",
        device: str = "auto",
        **given: Any,
    ) -> tuple[Any]:
        """Return the recolored pictures."""
        pictures, others = as_images("images", images), as_images("like", like)
        masks = None
        if mask is not None:
            shapes = [picture.shape for picture in pictures]
            masks = np.concatenate(as_masks("mask", mask, shapes))
        running = Running(1)
        # Below one another they are one picture, and so have one map.
        found = recolor(
            np.concatenate(pictures), np.concatenate(others), mask=masks,
            backend=get_backend(device), progress=running,
            **given | widgets.more_options(options, self.OPTIONS),
        )  # fmt: skip
        running.unit()
        frames = np.split(np.asarray(found), len(pictures))
        return as_image_and_mask(frames, has_opacity(images))[:1]


class LoadLut(Node):
    """Read a table of colors."""

    RETURN_TYPES: ClassVar[tuple[str, ...]] = (LUT,)
    RETURN_NAMES: ClassVar[tuple[str, ...]] = ("lut",)
    OUTPUT_TOOLTIPS: ClassVar[tuple[str, ...]] = ("The table, for Apply LUT.",)
    DESCRIPTION = "Reads a table of colors: a .cube file, or a HALD picture."

    REQUIRED: ClassVar[Inputs] = {
        "path": widgets.line("look.cube", "Path of the file, from ComfyUI's folder for inputs on.")
    }
    OPTIONAL: ClassVar[Inputs] = {}

    @classmethod
    def VALIDATE_INPUTS(cls, path: str | None = None) -> bool | str:  # noqa: N802
        """Return True, or that there is no such file; a path that a node gives comes later."""
        if path is None or input_path(path).is_file():
            return True
        return f"{printable(path)}: no such file; expected a .cube file or a HALD picture"

    @classmethod
    def IS_CHANGED(cls, path: str) -> str:  # noqa: N802 (ComfyUI's)
        """Return what differs when the content of the file does."""
        file = input_path(path)
        return digest(file) if file.is_file() else ""

    def run(self, path: str) -> tuple[Lut]:
        """Return the table."""
        return (read_lut(input_path(path)),)


class ApplyLut(Node):
    """Apply a table of colors to pictures."""

    RETURN_TYPES: ClassVar[tuple[str, ...]] = ("IMAGE",)
    RETURN_NAMES: ClassVar[tuple[str, ...]] = ("images",)
    OUTPUT_TOOLTIPS: ClassVar[tuple[str, ...]] = ("The pictures in their new colors.",)
    DESCRIPTION = "Applies a table of colors to every picture of a batch."

    REQUIRED: ClassVar[Inputs] = {
        "images": RECOLORED,
        "lut": (LUT, {"tooltip": "The table, from Load LUT."}),
        "strength": widgets.option(RecolorOptions, "strength"),
    }
    OPTIONAL: ClassVar[Inputs] = {"mask": MASK, **Node.OPTIONAL}

    def run(
        self, images: Any, lut: Lut, strength: float, mask: Any = None, device: str = "auto"
    ) -> tuple[Any]:
        """Return the recolored pictures."""
        pictures = as_images("images", images)
        masks: list[Any] = [None] * len(pictures)
        if mask is not None:
            masks = list(as_masks("mask", mask, [picture.shape for picture in pictures]))
        running, operations = Running(len(pictures)), get_backend(device)
        found = (
            np.asarray(apply_lut(picture, lut, mask=each, strength=strength, backend=operations))
            for picture, each in zip(pictures, masks, strict=True)
        )
        return as_image_and_mask(list(running.each(found)), has_opacity(images))[:1]


#: The classes by the names under which ComfyUI's workflows keep them.
NODE_CLASS_MAPPINGS: dict[str, type[Node]] = {
    f"Clmorph{kind.__name__}": kind for kind in (Morph, Mix, Rearrange, Recolor, LoadLut, ApplyLut)
}
#: The names that people see.
NODE_DISPLAY_NAME_MAPPINGS = {
    name: f"{kind.__name__.replace('Lut', ' LUT')} (clmorph)"
    for name, kind in NODE_CLASS_MAPPINGS.items()
}
