"""Draw a morph of two faces with and without landmarks: ``python tools/draw_landmarks.py out.png``.

``--faces`` draws what ``landmarks="auto"`` makes of two portraits: without landmarks, with those of
the cascade, and with those of the mesh (which needs the extra ``faces``). ``--measure`` prints how
many pixels landmarks miss their partners by, on random pictures.
"""

from pathlib import Path

import numpy as np
from drawing import parser
from PIL import Image
from scipy.ndimage import gaussian_filter
from skimage import data

import clmorph
from clmorph.images.finding.cascade import cascade_faces
from clmorph.images.finding.common import MESHED, SEARCHED
from clmorph.images.finding.mesh import mesh_faces
from clmorph.images.finding.reduced import small_copy
from clmorph.images.pixels import to_bytes

#: Left, top and side of the close-up of the astronaut, and the number of the other face.
PORTRAIT, MAN = (120, 30, 200), 3
TIMES = np.linspace(0.0, 1.0, 7)
#: Left, top and side of the square that is taken of each photograph, and the side of the drawing.
CUTS = {"astronaut": (165, 55, 120), "chelsea": (60, 0, 300)}
SIDE = 160
#: Corners of the eyes, nose, mouth and its corners, in pixels of the squares.
FACES = {
    "astronaut": [(29, 44), (45.7, 46.7), (74.3, 49), (93.3, 49.3), (61.7, 70), (58.3, 91),
                  (39.3, 86), (78.3, 86.7)],
    "chelsea": [(77, 105), (148, 136), (236, 152), (284, 114), (204.5, 243), (195.5, 268),
                (132, 273), (245, 273)],
}  # fmt: skip


def face(name: str) -> np.ndarray:
    """Return the square of a photograph with a face: (side, side, 3) bytes."""
    left, top, side = CUTS[name]
    return np.asarray(getattr(data, name)()[top : top + side, left : left + side])


def portraits() -> list[np.ndarray]:
    """Return a photograph of a face, and a small gray one of scikit-image's collection."""
    left, top, side = PORTRAIT
    man = Image.fromarray(np.uint8(255 * data.lfw_subset()[MAN])).resize(
        (side, side), Image.LANCZOS
    )
    woman = data.astronaut()[top : top + side, left : left + side]
    return [woman, np.dstack([np.asarray(man)] * 3)]


def found(images: list[np.ndarray], *, mesh: bool) -> list:
    """Return the landmarks that the mesh or the cascade finds in two portraits."""
    places = []
    for image in images:
        copy = small_copy(image / 255.0, MESHED if mesh else SEARCHED)
        faces = mesh_faces(copy) if mesh else cascade_faces(copy)
        places.append(copy.whole(faces[0]).tolist())
    return list(zip(*places, strict=True))


def draw(path: Path, device: str, *, by_auto: bool) -> None:
    """Draw rows of frames: without landmarks, and with them."""
    if by_auto:
        faces = portraits()
        ways = [None, found(faces, mesh=False), found(faces, mesh=True)]
    else:
        faces = [face(name) for name in FACES]
        ways = [None, list(zip(*FACES.values(), strict=True))]
    rows = []
    for landmarks in ways:
        morph = clmorph.morph(*faces, landmarks=landmarks, n_frames=3, backend=device)
        frames = [Image.fromarray(to_bytes(morph.frame(t))) for t in TIMES]
        rows.append(np.hstack([each.resize((SIDE, SIDE), Image.LANCZOS) for each in frames]))
    Image.fromarray(np.vstack(rows)).save(path, optimize=True)


def random_picture(rng: np.random.Generator, side: int) -> np.ndarray:
    found = np.stack([gaussian_filter(rng.random((side, side)), 5) for _ in range(3)], -1)
    return np.asarray((found - found.min()) / np.ptp(found))


def random_landmarks(rng: np.random.Generator, side: int, count: int, most: float) -> list:
    """Return landmarks at least 0.09 sides apart, moved smoothly by `most` pixels at most."""
    places: list = []
    while len(places) < count:
        place = rng.uniform(0.08 * side, 0.92 * side, 2).round()
        if all(np.hypot(*(place - other)) > 0.09 * side for other in places):
            places.append(place)
    fields = [
        gaussian_filter(rng.standard_normal((side, side)), side / 6, mode="constant") for _ in "xy"
    ]
    moves = np.array([[field[int(y), int(x)] for field in fields] for x, y in places])
    moves *= most / np.abs(moves).max()
    return [(tuple(place), tuple(place + move)) for place, move in zip(places, moves, strict=True)]


def measure(device: str) -> None:
    """Print the misses of mean destinations, by number of landmarks, blur and reach."""
    print("side  landmarks  blur   reach  largest miss  mean (pixels)")
    for side, count in ((64, 8), (64, 30), (64, 60), (256, 8), (256, 30), (256, 60)):
        rng = np.random.default_rng(1)
        images = [random_picture(rng, side) for _ in "ab"]
        landmarks = random_landmarks(rng, side, count, 0.05 * side)
        for blur, reach in ((0.05, None), (0.05, 0.3), (0.02, None), (0.02, 0.3), (0.005, 0.3)):
            morph = clmorph.morph(
                *images, landmarks=landmarks, blur=blur, reach=reach, n_frames=2, preset="photo",
                barycentric=True, backend=device,
            )  # fmt: skip
            ends = morph.plan.positions * (side - 1)
            missed = [
                np.hypot(*(ends[int(y) * side + int(x)] - partner)) for (x, y), partner in landmarks
            ]
            print(f"{side:4}  {count:9}  {blur:<5}  {reach!s:5}  {max(missed):12.2f}  "
                  f"{np.mean(missed):.2f}", flush=True)  # fmt: skip


def main() -> None:
    options = parser(__doc__, optional=True)
    options.add_argument("--faces", action="store_true", help="draw what is found in portraits")
    options.add_argument("--measure", action="store_true", help="print misses")
    given = options.parse_args()
    if given.output is not None:
        draw(given.output, given.device, by_auto=given.faces)
    if given.measure:
        measure(given.device)


if __name__ == "__main__":
    main()
