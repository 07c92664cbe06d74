"""The command ``clmorph demo``: a pixel-art cat becomes a photograph of a cat."""

from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clmorph.backends.interface import Operations
from clmorph.cli.terminal import Stages
from clmorph.images.pixels import as_rgb, fit, read_image, to_bytes
from clmorph.output.playback import Motion
from clmorph.output.save import Output, recorded_for, write_all
from clmorph.pipeline.morph import morph

#: Pixels along a block of the enlarged sprite, and pixels along the photograph.
SPRITE_ZOOM = 6
PHOTO_SIDE = 256
#: Names of the pictures on the page of the studio.
SAMPLES = ("sprite.png", "photograph.png")


def demo_images() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the sprite (192 x 192) and the photograph (256 x 256)."""
    from skimage.data import chelsea

    with resources.as_file(resources.files("clmorph.cli.samples") / "cat.png") as file:
        sprite = read_image(file)
    blocks = np.ones((SPRITE_ZOOM, SPRITE_ZOOM, 1))
    return np.asarray(np.kron(sprite, blocks), float), fit(as_rgb(chelsea()[:, 85:385]), PHOTO_SIDE)


def write_samples(folder: Path) -> list[Path]:
    """Write both pictures to a folder, for the studio, and return their paths."""
    paths = [folder / name for name in SAMPLES]
    for path, pixels in zip(paths, demo_images(), strict=True):
        Image.fromarray(np.ascontiguousarray(to_bytes(pixels))).save(path)
    return paths


def run_demo(operations: Operations, folder: Path, stages: Stages) -> list[str]:
    """Make the demo's files in a folder, and return lines for the user about them."""
    files = [folder / f"clmorph-demo{ending}" for ending in (".gif", ".html", ".png")]
    outputs = [Output(file) for file in files]
    sprite, photo = demo_images()
    result = morph(sprite, photo, backend=operations, progress=stages)
    with recorded_for(
        outputs, [result], Motion(), parameters=result.parameters, progress=stages
    ) as recording:
        write_all(outputs, recording, report=stages.writing)
    seconds = ", ".join(f"{stage} {time:.1f} s" for stage, time in stages.seconds.items())
    return [
        f"pictures: {sprite.shape[1]}x{sprite.shape[0]} into {photo.shape[1]}x{photo.shape[0]} "
        f"pixels, {len(result.particles)} particles",
        "options: the defaults of clmorph morph",
        f"solver: {result.potentials.message}",
        f"times: {seconds}",
        *(f"wrote {file.name}" for file in files),
    ]
