"""``.html``: a page that plays the morph, without network."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.progress import Report, Share
from clmorph.output.framing import Framing, Look, in_time
from clmorph.output.html import Curve, Field, Scene, write_page
from clmorph.output.html.summary import arrow_field, known_parameters, morph_curves
from clmorph.output.recording import Film


def write(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write one self-contained page, frames at their own sizes unless the look names one."""
    span = float(max(len(film.morphs), 1))
    backwards = bool(film.times[0] > film.times[-1])
    fields = list(_fields(film))
    scene = Scene(
        frames=_Frames(film, look, report),
        times=span - film.times if backwards else film.times,
        fps=film.motion.fps,
        hold=film.motion.hold,
        loop=film.motion.loop,
        title=_title(film),
        pixelated=film.pixelated if look.scaling == "auto" else look.scaling == "nearest",
        curves=_curves(film),
        field=[_turned(field, span) for field in fields] if backwards else fields,
        parameters=film.parameters,
        facts=known_parameters(film.morphs[0]) if len(film.morphs) == 1 else {},
        extent=film.morphs[0].source.extent,
    )
    with file.open("w", encoding="ascii", newline="\n") as stream:
        write_page(scene, stream)


class _Frames(Sequence[NDArray[np.uint8]]):
    """A film's frames as the look wants them, each reported when it is read."""

    def __init__(self, film: Film, look: Look, report: Report) -> None:
        self._film, self._report = film, report
        self._framing = Framing(look, in_time(film.shapes, film.times), film.pixelated)
        self._scaled = look.canvas != "dynamic"

    def __len__(self) -> int:
        return len(self._film)

    def __getitem__(self, index: Any) -> Any:
        frame = self._film.picture(index)
        picture = self._framing(frame) if self._scaled else self._framing.unscaled(frame)
        done = index + 1
        self._report(Share(done / len(self), f"{done} of {len(self)}"))
        return np.asarray(picture)


def _title(film: Film) -> str:
    """Return the pictures' names, where the film's parameters tell them."""
    images = film.parameters.get("images") or ()
    names = [Path(str(image["file"])).stem for image in images if "file" in image]
    ordered = names[::-1] if film.times[0] > film.times[-1] else names
    return " → ".join(ordered) or "Morph"


def _curves(film: Film) -> list[Curve]:
    """Return the curves of each morph of a chain, one after the other."""
    owner = np.minimum(film.times.astype(int), len(film.morphs) - 1)
    curves: dict[str, Curve] = {}
    for number, morph in enumerate(film.morphs):
        mine = owner == number
        for curve in morph_curves(morph, film.times[mine] - number):
            whole = curves.setdefault(
                curve.name, Curve(curve.name, curve.unit, np.zeros(len(film)))
            )
            whole.values[mine] = curve.values
    return list(curves.values())


def _fields(film: Film) -> list[Field]:
    found = [(number, arrow_field(morph)) for number, morph in enumerate(film.morphs)]
    return [
        replace(field, begin=float(number), end=number + 1.0)
        for number, field in found
        if field is not None
    ]


def _turned(field: Field, span: float) -> Field:
    """Return a field whose arrows travel back."""
    return replace(
        field, positions=field.positions + field.displacement, displacement=-field.displacement,
        begin=span - field.end, end=span - field.begin,
    )  # fmt: skip
