"""The command ``clmorph studio``: a local web page."""

from pathlib import Path

import numpy as np
from PIL import Image

from clmorph.cli.common import device_name
from clmorph.cli.demo import demo_images
from clmorph.cli.reporting import line_of
from clmorph.cli.terminal import say
from clmorph.images.pixels import to_bytes
from clmorph.studio.serve import serve

#: Names of the bundled pictures on the page.
SAMPLES = ("sprite.png", "photograph.png")


def run_studio(
    host: str, port: int | None, device: str | None, backend: str | None, browser: bool
) -> None:
    """Serve the studio until it is ended."""
    serve(
        host, port, device=device_name(device, backend), browser=browser, samples=write_samples,
        line_of=line_of, say=say,
    )  # fmt: skip


def write_samples(folder: Path) -> list[Path]:
    """Write the bundled pictures to a folder, and return their paths."""
    paths = [folder / name for name in SAMPLES]
    for path, pixels in zip(paths, demo_images(), strict=True):
        Image.fromarray(np.ascontiguousarray(to_bytes(pixels))).save(path)
    return paths
