"""Draw how one picture's pixels form another one: ``python tools/draw_rearranged.py out.png``."""

from pathlib import Path

import numpy as np
from drawing import parser, square
from PIL import Image

import clmorph

#: Times of the drawn frames; the pictures A and B themselves stand before and after them.
TIMES = (0.0, 0.15, 0.35, 0.6, 1.0)
#: Left, top and side of the square that is taken of each photograph, and the side of the drawing.
CUTS = {"astronaut": (85, 0, 340), "chelsea": (75, 0, 300), "coffee": (100, 0, 400)}
PAIRS = (("coffee", "chelsea"), ("astronaut", "chelsea"))
SIDE = 192


def draw(path: Path, device: str, folder: Path | None) -> None:
    """Draw a row of frames for each pair and, after them, the picture that the pixels form."""
    rows = []
    for names in PAIRS:
        a, b = (square(name, CUTS[name], SIDE) for name in names)
        found = clmorph.rearrange(a, b, backend=device)
        frames = [np.rint(255 * found.frame(t)).astype(np.uint8) for t in TIMES]
        rows.append(np.hstack([*frames, b]))
        print(
            f"{' to '.join(names)}: cost {found.cost:.4f}, at most "
            f"{found.cost / found.lower_bound - 1:.2%} above the cheapest"
        )
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            for t, frame in zip(TIMES, frames, strict=True):
                Image.fromarray(frame).save(folder / f"{'-'.join(names)}-{t:.2f}.png")
    Image.fromarray(np.vstack(rows)).save(path, optimize=True)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--frames", type=Path, help="a folder for single frames")
    given = options.parse_args()
    draw(given.output, given.device, given.frames)


if __name__ == "__main__":
    main()
