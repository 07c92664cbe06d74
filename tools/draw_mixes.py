"""Draw mixes of four photographs and of four drawings: ``python tools/draw_mixes.py out.png``."""

import time
from pathlib import Path

import numpy as np
from drawing import parser, square
from drawn_pictures import logo
from PIL import Image

import clmorph

#: Left, top and side of the square that is taken of each photograph.
CUTS = {
    "retina": (0, 0, 1411),
    "coffee": (180, 20, 330),
    "astronaut": (150, 10, 150),
    "chelsea": (75, 0, 300),
}
DRAWINGS = ("star", "disc", "bars", "ring")
#: Mixes along a side, and white pixels between both grids.
GRID, GAP = 5, 16


def draw(path: Path, side: int, device: str) -> None:
    """Draw both grids side by side, and print how long each took."""
    operations = clmorph.get_backend(device)
    grids = []
    for kind, images in (
        ("photographs", [square(name, cut, side) for name, cut in CUTS.items()]),
        ("drawings", [logo(name, side) for name in DRAWINGS]),
    ):
        began = time.perf_counter()
        grids.append(clmorph.mix(images, grid=GRID, backend=operations).sheet())
        seconds = time.perf_counter() - began
        print(f"{GRID * GRID} mixes of four {kind} of {side} pixels: {seconds:.1f} s")
    gap = np.full((grids[0].shape[0], GAP, 3), 255, np.uint8)
    Image.fromarray(np.hstack((grids[0], gap, grids[1]))).save(path, optimize=True)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--side", type=int, default=96, help="pixels along a side of a mix")
    given = options.parse_args()
    draw(given.output, given.side, given.device)


if __name__ == "__main__":
    main()
