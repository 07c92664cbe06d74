"""Draw the bundled pixel-art sprite, a ginger cat: ``python tools/draw_sprite.py``.

Drawn for this project; the picture is under CC0 1.0 (see clmorph/data/LICENSE).
"""

from pathlib import Path

import numpy as np
from PIL import Image

PALETTE = {
    ".": (118, 158, 142),  # wall
    "k": (54, 34, 30),  # outline
    "o": (222, 146, 72),  # fur
    "d": (176, 98, 44),  # stripes
    "l": (244, 192, 128),  # light fur
    "w": (252, 240, 222),  # muzzle
    "p": (232, 136, 138),  # ears, nose
    "g": (146, 196, 74),  # eyes
    "x": (28, 22, 24),  # pupils
    "h": (255, 255, 255),  # highlights
}

LEFT_HALF = """
................
................
...kk...........
..kook..........
..kopok.........
..koppok........
..kopppok...kkkk
..kopppookkkoodd
..koppooodoodood
..kopooodooddodd
..kooooodooodood
..koooooodoooodo
.kooooooooooooll
.koolllooooooooo
.kollkkkkloooooo
kddlkgggghklooll
kooklgxxggklooll
koolkgxxgggkolll
kddlkggxgggkllww
koollkggggklllww
kdoolkkkkklllwww
kooooollllllwwpp
kddoolllwwwwwwwp
.kooolwwwwwwwwww
.kodolwwwwwwwkww
..kodlllwwwwwwkk
..kkooolllwwwwww
....kooollllwwww
.....kkooolllllw
.......kkkoooool
..........kkkkkk
................
"""


def sprite() -> np.ndarray:
    rows = LEFT_HALF.split()
    art = [row + row[::-1] for row in rows]
    return np.array([[PALETTE[letter] for letter in row] for row in art], np.uint8)


if __name__ == "__main__":
    target = Path(__file__).parents[1] / "clmorph" / "data" / "cat.png"
    Image.fromarray(sprite()).save(target, optimize=True)
    print(f"{target}: {sprite().shape[1]} x {sprite().shape[0]} pixels")
