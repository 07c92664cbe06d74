"""What the extra ``faces`` (mediapipe) finds: points of faces, and people before a background."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph.images.finding.reduced import Bytes, Copy

#: Points of the mesh: outline, eyes, brows, nose, mouth, what is between them, and more outline.
OUTLINE = (10, 297, 284, 389, 454, 361, 397, 378, 152, 149, 172, 132, 234, 162, 54, 67)
EYES = (33, 163, 145, 154, 133, 157, 159, 161, 263, 390, 374, 381, 362, 384, 386, 388)
BROWS = (70, 63, 105, 66, 107, 300, 293, 334, 296, 336)
NOSE = (168, 197, 4, 2, 98, 327)
MOUTH = (61, 91, 84, 17, 314, 321, 291, 270, 267, 0, 37, 40)
CHEEKS = (427, 101, 330, 207, 346, 420, 280, 151, 47, 337, 50, 434, 418, 108, 194, 426, 9, 430)
BETWEEN = (338, 332, 251, 356, 323, 288, 365, 379, 400, 377, 148, 176, 150, 136, 58, 93, 127, 21,
           103, 109)  # fmt: skip
SIDES = (147, 376, 123, 352, 192, 416, 143, 372, 92, 322)
#: The most important ones come first.
MESH = (*OUTLINE, *EYES, *BROWS, *NOSE, *MOUTH, *CHEEKS, *SIDES, *BETWEEN)
#: Largest number of faces of a picture.
MOST_FACES = 4
#: Side of the square around a face in which its mesh is sought, in sides of the face's box.
AROUND = 2.0
#: Margin around a picture, as a share of its sides, with which a face that fills it is found.
MARGIN = 0.3
#: Shares of two boxes' joint area above which they are one face.
SAME = 0.3
#: Least and largest share of a picture that a person takes.
PERSON = (0.05, 0.9)


def mesh_missing() -> str:
    """Return why the extra ``faces`` cannot be used and what to do; "" if it can be."""
    if find_spec("mediapipe") is None:
        if sys.version_info >= (3, 13):
            return "with Python 3.12 or older, clmorph[faces] finds eyes, mouths and people"
        return 'pip install "clmorph[faces]" adds what finds eyes, mouths and people'
    try:
        import mediapipe
    except ImportError as error:
        return f"mediapipe cannot be imported ({error}); install clmorph[faces] anew"
    if not hasattr(mediapipe, "solutions"):
        version = getattr(mediapipe, "__version__", "")
        return f"mediapipe {version} ships no models; clmorph[faces] installs a version that does"
    return ""


@contextmanager
def _solutions() -> Iterator[Any]:
    """Give mediapipe's models; its warnings about its own dependencies are not the user's."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mediapipe

        yield mediapipe.solutions


def mesh_faces(copy: Copy, numbers: tuple[int, ...] = MESH) -> list[Array]:
    """Return points of each face, the largest first: (n, 2) arrays in pixels of the copy."""
    found: list[Array] = []
    with _solutions() as models, ExitStack() as opened:
        # For faces far away, and for near ones.
        detector = partial(models.face_detection.FaceDetection, min_detection_confidence=0.5)
        detectors = [opened.enter_context(detector(model_selection=kind)) for kind in (1, 0)]
        boxes = _boxes(copy.pixels, detectors)
        if not boxes:
            margin = int(MARGIN * max(copy.pixels.shape[:2]))
            padded = np.pad(copy.pixels, ((margin,) * 2, (margin,) * 2, (0, 0)), mode="edge")
            boxes = [box - (margin, margin, 0.0) for box in _boxes(padded, detectors)]
        if not boxes:
            boxes = _small_boxes(copy.pixels, detectors)
        with models.face_mesh.FaceMesh(static_image_mode=True, max_num_faces=1) as model:
            for box in boxes[:MOST_FACES]:
                places = _mesh(copy.pixels, box, model)
                if places is not None:
                    found.append(places[list(numbers)])
    return found


def person(copy: Copy) -> BoolArray | None:
    """Return where a person stands before a background, (H, W); None if nobody does."""
    with (
        _solutions() as models,
        models.selfie_segmentation.SelfieSegmentation(model_selection=0) as model,
    ):
        found = np.asarray(model.process(copy.pixels).segmentation_mask) > 0.5
    return found if PERSON[0] < found.mean() < PERSON[1] else None


def _boxes(pixels: Bytes, detectors: list[Any]) -> list[Array]:
    """Return boxes of faces, the largest first: middle and longer side, in pixels."""
    height, width = pixels.shape[:2]
    found: list[Array] = []
    for detector in detectors:
        for each in detector.process(pixels).detections or []:
            box = each.location_data.relative_bounding_box
            middle = (box.xmin + box.width / 2) * width, (box.ymin + box.height / 2) * height
            found.append(np.array([*middle, max(box.width * width, box.height * height)]))
    return _distinct(found)


def _small_boxes(pixels: Bytes, detectors: list[Any]) -> list[Array]:
    """Return boxes of faces that are found in nine overlapping parts, the largest first."""
    height, width = pixels.shape[:2]
    found: list[Array] = []
    for top in (0, height // 4, height // 2):
        for left in (0, width // 4, width // 2):
            part = np.ascontiguousarray(pixels[top : top + height // 2, left : left + width // 2])
            found += [box + np.array((left, top, 0.0)) for box in _boxes(part, detectors)]
    return _distinct(found)


def _distinct(boxes: list[Array]) -> list[Array]:
    """Return the first of all boxes of each face, the largest first."""
    found: list[Array] = []
    for box in boxes:
        if all(_apart(box, other) for other in found):
            found.append(box)
    return sorted(found, key=lambda box: -box[2])


def _apart(one: Array, other: Array) -> bool:
    common = np.prod(np.clip(
        np.minimum(one[:2] + one[2] / 2, other[:2] + other[2] / 2)
        - np.maximum(one[:2] - one[2] / 2, other[:2] - other[2] / 2), 0.0, None,
    ))  # fmt: skip
    return bool(common < SAME * (one[2] ** 2 + other[2] ** 2 - common))


def _mesh(pixels: Bytes, box: Array, model: Any) -> Array | None:
    """Return all points of the mesh of the face in a box, in pixels."""
    side = max(8, round(AROUND * box[2]))
    left, top = (round(float(each) - side / 2) for each in box[:2])
    height, width = pixels.shape[:2]
    rows = np.clip(np.arange(top, top + side), 0, height - 1)
    columns = np.clip(np.arange(left, left + side), 0, width - 1)
    found = model.process(np.ascontiguousarray(pixels[rows][:, columns])).multi_face_landmarks
    if not found:
        return None
    places = np.array([(each.x, each.y) for each in found[0].landmark])
    places = places * side - 0.5 + (left, top)
    middle = places.mean(axis=0)
    inside = np.all((middle > 0) & (middle < (width, height)))
    return places if inside else None
