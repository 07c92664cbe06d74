"""Measure how sharp and how clean frames are: ``python tools/evaluate_pictures.py``.

For pairs of pictures at t = 1/4, 1/2 and 3/4, by default (the preset that the pictures choose) and
by the preset photo with `detail="particles"`: the mean gradient (*sharp*) and the share of specks
(*crumbs*), both relative to the mixture by t of those of the ends. For pictures paired with their
own smooth deformation by 6 %: how much nearer the frame at 1/2 is to the true middle than a
cross-fade, in dB. Prints Markdown tables; ``--pictures FOLDER`` keeps the frames of each pair, the
default above, and ``--only NAME`` takes the pairs with a name.
"""

import argparse
from pathlib import Path

import numpy as np
from picture_pairs import DEFORMED, DRAWINGS, PHOTOGRAPHS, deformed, picture, psnr
from PIL import Image
from rich.progress import track

import clmorph
from clmorph.analysis.metrics import crumbs, mean_gradient

TIMES = (0.25, 0.5, 0.75)
WAYS = ({}, {"preset": "photo", "detail": "particles"})
#: Less than this share of specks in the pictures themselves counts as this share.
FEWEST_CRUMBS = 1e-3


def relative(measure, frame: np.ndarray, ends: list[np.ndarray], t: float, least=1e-9) -> float:
    """Return a measure of a frame, relative to the mixture of those of both ends."""
    first, second = map(measure, ends)
    return measure(frame) / max(least, (1 - t) * first + t * second)


def strip(frames: list[np.ndarray]) -> np.ndarray:
    """Return frames side by side, on white."""
    height = max(frame.shape[0] for frame in frames)
    return np.hstack(
        [
            np.pad(frame, ((0, height - len(frame)), (0, 4), (0, 0)), constant_values=1)
            for frame in frames
        ]
    )


def judge(names: tuple[str, str], folder: Path | None, device: str) -> str:
    """Return the table row of a pair."""
    ends = [picture(name) for name in names]
    cells, strips = [], []
    for way in WAYS:
        morph = clmorph.morph(*ends, n_frames=3, backend=device, **way)
        frames = [morph.frame(t)[..., :3] for t in TIMES]
        pairs = list(zip(frames, TIMES, strict=True))
        cells.append(" ".join(f"{relative(mean_gradient, f, ends, t):.2f}" for f, t in pairs))
        cells.append(
            " ".join(f"{relative(crumbs, f, ends, t, FEWEST_CRUMBS):.2f}" for f, t in pairs)
        )
        strips.append(strip(frames))
    if folder:
        width = max(each.shape[1] for each in strips)
        padded = [
            np.pad(each, ((0, 4), (0, width - each.shape[1]), (0, 0)), constant_values=1)
            for each in strips
        ]
        levels = np.rint(255 * np.vstack(padded)).astype(np.uint8)
        Image.fromarray(levels).save(folder / f"{names[0]}-{names[1]}.png".replace(" ", "-"))
    return f"| {names[0]}, {names[1]} | " + " | ".join(cells) + " |"


def judge_deformed(name: str, seed: int, device: str) -> str:
    """Return the table row of a picture and its own deformation."""
    first = picture(name)
    truth, last = deformed(first, seed)
    fade = psnr((first + last) / 2, truth)
    gains = [
        psnr(
            clmorph.morph(first, last, n_frames=3, backend=device, **way).frame(0.5)[..., :3],
            truth,
        )
        - fade
        for way in WAYS
    ]
    return f"| {name}, {seed} | {fade:.1f} | " + " | ".join(f"{gain:+.1f}" for gain in gains) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    pairs = [pair for pair in PHOTOGRAPHS + DRAWINGS if not options.only or options.only in pair]
    print("| pair | sharp | crumbs | sharp, particles | crumbs, particles |")
    print("|---|---|---|---|---|")
    for pair in track(pairs, "pairs", transient=True):
        print(judge(pair, options.pictures, options.device), flush=True)
    print("\n| deformed, seed | cross-fade, dB | default | particles |\n|---|---|---|---|")
    for name in track(DEFORMED, "deformed", transient=True):
        if not options.only or options.only == name:
            for seed in (0, 1, 2):
                print(judge_deformed(name, seed, options.device), flush=True)


if __name__ == "__main__":
    main()
