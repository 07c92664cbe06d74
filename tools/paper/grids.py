"""Figure 3: a canvas that changes its size with t, against one that keeps the target's."""

import numpy as np

import clmorph
from clmorph.frames.canvas import canvas_at
from clmorph.frames.render import render
from paper import drawing
from paper.setting import AS_PAPER_TEXT, Section, Setting, paper_morph
from paper.timelines import TIMES, sizes

#: Sides of source and target, in parts of the size: the paper's 64 and 16 at 48.
LARGE, SMALL = 4 / 3, 1 / 3


def figure_3(setting: Setting) -> list[Section]:
    """Compare the canvas that changes its size with one that keeps the target's."""
    sides = max(4, round(LARGE * setting.size)), max(4, round(SMALL * setting.size))
    images = setting.pair.fitted(*sides)
    reduced = setting.pair.fitted(sides[1], sides[1])
    setting.report("Figure 3", 0.0)
    dynamic = paper_morph(setting, images)
    setting.report("Figure 3", 0.5)
    small = paper_morph(setting, reduced)
    rows = [
        ("dynamic\ngrid", [dynamic.frame(t) for t in TIMES]),
        ("fixed grid,\nsame particles", [_on_target_grid(dynamic, t) for t in TIMES]),
        ("fixed grid,\nsource\nreduced first", [small.frame(t) for t in TIMES]),
    ]
    setting.report("Figure 3", 1.0)
    drawing.timeline(setting.folder / "figure-3.png", rows, TIMES)
    likeness = [_decibels(frames[0], images[0]) for _, frames in rows]
    numbers = [
        [" ".join(label.split()), t, frame.shape[1], frame.shape[0],
         _decibels(frame, images[0]), _decibels(frame, images[1])]
        for label, frames in rows
        for t, frame in zip(TIMES, frames, strict=True)
    ]  # fmt: skip
    return [
        Section(
            "figure-3",
            "Figure 3: dynamic against fixed grid",
            "A large source becomes a small target: on a canvas whose sides change with t; on "
            "the target's grid throughout, with the same particles; and with the source reduced "
            "to the target's size beforehand.",
            f"{sizes(images)}, {AS_PAPER_TEXT}.",
            f"At t = 0 the dynamic grid is {likeness[0]:.1f} dB from the source (PSNR, enlarged "
            f"block by block), the fixed one {likeness[1]:.1f} dB, and {likeness[2]:.1f} dB with "
            "the source reduced first.",
            ["row", "t", "width", "height", "psnr to source dB", "psnr to target dB"],
            numbers,
        )
    ]


def _on_target_grid(one: clmorph.Morph, t: float) -> np.ndarray:
    """Render a frame on the target's canvas for any t."""
    moving, shape = one.particles, one.target.shape
    uploaded = one.operations.upload_particles(moving.table, moving.links, moving.weights)
    canvas = canvas_at(1.0, shape, shape, one.source.extent)
    widths = one.kernel_width.widths(t, canvas)
    return render(one.operations, uploaded, moving.mass(t), t, canvas, widths).colors


def _decibels(frame: np.ndarray, image: np.ndarray) -> float:
    """Return the PSNR of two pictures, the smaller enlarged block by block."""
    height = max(frame.shape[0], image.shape[0])
    width = max(frame.shape[1], image.shape[1])
    large = []
    for picture in (frame, image):
        row, column = (
            np.arange(side) * own // side
            for side, own in zip((height, width), picture.shape[:2], strict=True)
        )
        large.append(picture[row][:, column])
    error = float(np.mean((large[0] - large[1]) ** 2))
    return 10 * np.log10(1 / max(error, 1e-12))
