"""Draw the bundled pixel art, a ginger cat and a toadstool: ``python tools/draw_sprite.py``.

Drawn for this project; the pictures are under CC0 1.0 (see clmorph/cli/samples/LICENSE).
"""

from pathlib import Path

import numpy as np
from PIL import Image

CAT_COLORS = {
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

CAT_LEFT_HALF = """
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


TOADSTOOL_COLORS = {
    ".": (0, 0, 0, 0),
    "k": (58, 26, 36, 255),  # outline
    "r": (206, 48, 52, 255),  # cap
    "d": (150, 30, 48, 255),  # its shadow
    "l": (238, 98, 82, 255),  # its light
    "w": (252, 244, 232, 255),  # dots
    "s": (218, 200, 190, 255),  # dots in the shadow
    "c": (250, 228, 192, 255),  # stem
    "e": (222, 184, 144, 255),  # its shadow
    "g": (92, 150, 70, 255),  # grass
    "h": (64, 112, 58, 255),  # grass in the shadow
    "x": (40, 28, 36, 255),  # eyes
    "p": (238, 150, 140, 255),  # cheeks
}

TOADSTOOL_LEFT_HALF = """
................
...........kkkkk
.........kklllll
.......kklllllll
......kllllwwwrr
.....kllllwwwwwr
....klllrwwwwwww
...klllrrwwwwwww
...kllrrrwwwwwww
..klwwrrrrwwwwwr
..kwwwwrrrrwwwrr
.klwwwwrrrrrrrrr
.klwwwwrrrrrrrrr
.krwwwwrrrrrrrrr
.krrwwrrrrrrrrrw
.kdrrrrrrrrrrrww
.kddrrrrwwwrrrws
.kdddrrwwwwwrrrs
..kddddrsswwdrrr
...kkddddssddddd
.....kkkkkdddddd
........kekkkkkk
........keeccccc
........kecccccc
........kecxxccc
........kecxxccc
........kecxxccc
.......kecppcccc
.......keccccccx
...g..gkeecccccc
..gghggkkeeeeccc
.ghhhhhhhkkkkkkk
"""


def sprite(left_half: str, colors: dict[str, tuple[int, ...]]) -> np.ndarray:
    """Return pixels of rows of letters and their mirror images."""
    art = [row + row[::-1] for row in left_half.split()]
    return np.array([[colors[letter] for letter in row] for row in art], np.uint8)


if __name__ == "__main__":
    folder = Path(__file__).parents[1] / "clmorph" / "cli" / "samples"
    for name, half, colors in (
        ("cat", CAT_LEFT_HALF, CAT_COLORS),
        ("toadstool", TOADSTOOL_LEFT_HALF, TOADSTOOL_COLORS),
    ):
        pixels = sprite(half, colors)
        Image.fromarray(pixels).save(folder / f"{name}.png", optimize=True)
        print(f"{folder / name}.png: {pixels.shape[1]} x {pixels.shape[0]} pixels")
