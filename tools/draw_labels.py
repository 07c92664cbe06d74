"""Draw a morph of two faces with and without labels: ``python tools/draw_labels.py labels.png``.

Each eye and the mouth have a label; all else is label 0.
"""

import numpy as np
from draw_landmarks import CUTS, FACES, SIDE, TIMES, face
from drawing import parser
from PIL import Image, ImageDraw

import clmorph

#: Ellipses around the eyes and the mouth, in units of the distance of their corners.
EYE, MOUTH = (0.72, 0.6), (0.68, 0.34)
#: Colors of the labels in the drawing; label 0 has none.
COLORS = np.array([(0, 0, 0), (230, 159, 0), (0, 158, 115), (0, 114, 178)], np.uint8)


def label_image(name: str) -> np.ndarray:
    """Return the labels of a face: (side, side) bytes."""
    side, points = CUTS[name][2], np.array(FACES[name])
    image = Image.new("L", (side, side))
    draw = ImageDraw.Draw(image)
    mouth = (points[6] + points[7]) / 2
    mouth[1] = (mouth[1] + points[5, 1]) / 2
    for label, (center, corners, (wide, high)) in enumerate(
        (
            ((points[0] + points[1]) / 2, (0, 1), EYE),
            ((points[2] + points[3]) / 2, (2, 3), EYE),
            (mouth, (6, 7), MOUTH),
        ),
        start=1,
    ):
        across = np.hypot(*np.subtract(*points[list(corners)]))
        radii = np.array((wide, high)) * across
        draw.ellipse((*(center - radii), *(center + radii)), fill=label)
    return np.asarray(image)


def shown(picture: np.ndarray) -> np.ndarray:
    """Return a picture at the size of the drawing's frames."""
    image = Image.fromarray(np.rint(picture).astype(np.uint8))
    return np.asarray(image.resize((SIDE, SIDE), Image.Resampling.LANCZOS))


def main() -> None:
    options = parser(__doc__).parse_args()
    faces, labels = [face(name) for name in FACES], tuple(label_image(name) for name in FACES)
    rows = []
    for own, given in enumerate((None, labels)):
        morph = clmorph.morph(
            *faces, labels=given, n_frames=2, preset="photo", backend=options.device
        )
        colored = np.where(labels[own][..., None] > 0, COLORS[labels[own]], faces[own])
        frames = [shown(0.5 * faces[own] + 0.5 * colored)]
        frames += [shown(255 * np.clip(morph.frame(t), 0, 1)) for t in TIMES]
        rows.append(np.hstack(frames))
        if given is not None:
            one, other = (
                clmorph.images.label_maps.reduced_labels(each.astype(int), measure.shape).ravel()
                for each, measure in zip(labels, (morph.source, morph.target), strict=True)
            )
            leaked = one[morph.plan.rows] != other[morph.plan.indices]
            print(f"mass between different labels: {morph.plan.mass[leaked].sum():g}")
    Image.fromarray(np.vstack(rows)).save(options.output, optimize=True)


if __name__ == "__main__":
    main()
