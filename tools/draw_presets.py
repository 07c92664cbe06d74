"""Draw how presets morph kinds of pictures: ``python tools/draw_presets.py presets.png``.

Each row is one pair of pictures by the preset that they choose themselves (``auto``). With
``--all`` there are rows by all presets for each pair, to be judged by eye.
"""

import numpy as np
from drawing import parser
from drawn_pictures import logo, sprite
from picture_pairs import picture
from PIL import Image
from rich.progress import track

import clmorph
from clmorph.pipeline.presets import PRESETS

TIMES = (0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0)
#: Height of the pictures, and width of the gaps, in pixels.
HEIGHT, GAP = 128, 6
#: Side of the squares of gray that show where a frame is transparent.
SQUARE = 8


def pairs() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return pairs of pictures, by name."""
    return {
        "sprites": (sprite("heart"), sprite("ghost")),
        "sprites on a background": tuple(
            sprite(name, 4, (20, 20, 40)) for name in ("invader", "heart")
        ),
        "logos": (logo("star", 256), logo("disc", 256)),
        "logos with opacity": tuple(logo(name, 256, ground=None) for name in ("ring", "bars")),
        "drawings": (picture("face"), picture("house")),
        "portraits": (picture("portrait"), picture("photographer")),
        "photographs": (picture("rocket"), picture("coffee")),
    }  # type: ignore[return-value]


def shown(frame: np.ndarray) -> np.ndarray:
    """Return a frame at the common height, on squares of gray where it is transparent."""
    height, width = frame.shape[:2]
    size = round(width * HEIGHT / height), HEIGHT
    # Whole pixels of sprites stay sharp.
    how = Image.Resampling.NEAREST if height < HEIGHT // 2 else Image.Resampling.LANCZOS
    channels = [
        Image.fromarray(np.float32(frame[..., each])).resize(size, how)
        for each in range(frame.shape[2])
    ]
    large = np.clip(np.dstack(channels), 0, 1)
    if large.shape[2] == 4:
        y, x = np.indices(large.shape[:2]) // SQUARE
        ground = np.where((x + y) % 2, 0.82, 0.95)[..., None]
        large = large[..., :3] * large[..., 3:] + ground * (1 - large[..., 3:])
    return np.pad(large, ((0, GAP), (0, GAP), (0, 0)), constant_values=1)


def main() -> None:
    given = parser(__doc__)
    given.add_argument("--all", action="store_true", help="all presets, not only the one chosen")
    given.add_argument("--only", default="", help="pairs whose name holds this")
    options = given.parse_args()
    presets = [name for name in PRESETS if name != "paper"] if options.all else ["auto"]
    chosen = [pair for name, pair in pairs().items() if options.only in name]
    rows = [
        np.hstack([shown(morph.frame(t)) for t in TIMES])
        for pair in track(chosen, "pairs", transient=True)
        for preset in presets
        for morph in [clmorph.morph(*pair, preset=preset, n_frames=3, backend=options.device)]
    ]
    width = max(row.shape[1] for row in rows)
    gaps = [((0, 0), (0, width - row.shape[1]), (0, 0)) for row in rows]
    sheet = np.vstack(
        [np.pad(row, gap, constant_values=1) for row, gap in zip(rows, gaps, strict=True)]
    )
    levels = np.rint(255 * sheet[:-GAP, :-GAP]).astype(np.uint8)
    Image.fromarray(levels).save(options.output, optimize=True)


if __name__ == "__main__":
    main()
