"""Draw a clip that becomes another one: ``python tools/draw_clips.py clips.png``.

Both clips are windows that move over a photograph. ``--changes`` prints the mean change from each
frame to the next, of 255, with a star where the transport was solved.
"""

import numpy as np
from drawing import parser
from PIL import Image
from skimage import data

import clmorph

#: The photographs with their sizes, and the steps in pixels by which the windows move.
CLIPS = (("astronaut", (360, 360), 2), ("coffee", (420, 300), 3))
#: Side of the windows, frames of the clips, frames a second, and seconds of the transition.
SIDE, COUNT, RATE, SECONDS = 176, 40, 20, 1.5
#: Frames between two pairs that are solved, and those that are drawn.
STEP, SHOWN = 5, (6, 13, 18, 22, 26, 30, 35, 43)


def clip(name: str, size: tuple[int, int], step: int) -> list[np.ndarray]:
    """Return the frames of a clip."""
    whole = np.asarray(Image.fromarray(getattr(data, name)()).resize(size))
    return [whole[20 : 20 + SIDE, x : x + SIDE] for x in range(10, 10 + COUNT * step, step)]


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--changes", action="store_true")
    given = options.parse_args()
    film = list(
        clmorph.morph_clip(
            *(clip(*each) for each in CLIPS), duration=SECONDS, fps=RATE, every=STEP / RATE,
            backend=given.device,
        )
    )  # fmt: skip
    half = len(SHOWN) // 2
    rows = [np.hstack([film[k] for k in part]) for part in (SHOWN[:half], SHOWN[half:])]
    clmorph.write_image(given.output, np.vstack(rows))
    begin = COUNT - round(SECONDS * RATE)
    for number in range(1, len(film)) if given.changes else ():
        solved = begin <= number < COUNT and (number - begin) % STEP == 0
        change = 255 * np.abs(film[number] - film[number - 1]).mean()
        print(f"{number:3d} {change:6.2f}{' *' if solved else ''}")


if __name__ == "__main__":
    main()
