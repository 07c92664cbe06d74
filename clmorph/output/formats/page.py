"""``.html``: a page that plays the morph without a network."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.items import MadeItems
from clmorph._shared.progress import Report, Share
from clmorph.output.formats.format import Format
from clmorph.output.html.page import read_metadata, write_page
from clmorph.output.html.scene import Curve, Field, Scene
from clmorph.output.html.summary import arrow_field, known_parameters, marks_of, morph_curves
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording


def write(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write one self-contained page, frames at their own sizes unless the style names one."""
    span = float(max(len(recording.morphs), 1))
    backwards = bool(recording.times[0] > recording.times[-1])
    fields = [
        replace(field, begin=float(number), end=number + 1.0)
        for number, morph in enumerate(recording.morphs)
        if (field := arrow_field(morph)) is not None
    ]
    framing, count = recording.framing(style), len(recording)
    images = recording.parameters.get("images") or ()
    names = [Path(str(image["file"])).stem for image in images if "file" in image]

    def picture(index: int) -> NDArray[np.uint8]:
        frame = recording.picture(index)
        found = framing.unscaled(frame) if style.canvas == "dynamic" else framing(frame)
        report(Share((index + 1) / count, f"{index + 1} of {count}"))
        return np.asarray(found)

    scene = Scene(
        frames=MadeItems(picture, count),
        times=span - recording.times if backwards else recording.times,
        fps=recording.motion.fps,
        hold=recording.motion.hold,
        loop=recording.motion.loop,
        title=" → ".join(names[::-1] if backwards else names) or recording.morphs[0].title,
        pixelated=style.is_nearest(recording.pixelated),
        curves=_curves(recording),
        fields=[_turned(field, span) for field in fields] if backwards else fields,
        parameters=recording.parameters,
        facts=known_parameters(recording.morphs[0]) if len(recording.morphs) == 1 else {},
        extent=recording.morphs[0].source.extent,
        # Only pictures that are not framed are those in whose pixels landmarks are.
        marks=marks_of(recording.morphs[0], backwards=backwards)
        if len(recording.morphs) == 1 and style.canvas == "dynamic"
        else None,
    )
    with file.open("w", encoding="ascii", newline="\n") as stream:
        write_page(scene, stream)


def _curves(recording: Recording) -> list[Curve]:
    """Return the curves of each morph of a chain, one after the other."""
    owner = np.minimum(recording.times.astype(int), len(recording.morphs) - 1)
    curves: dict[str, Curve] = {}
    for number, morph in enumerate(recording.morphs):
        mine = owner == number
        for curve in morph_curves(morph, recording.times[mine] - number):
            whole = curves.setdefault(
                curve.name, Curve(curve.name, curve.unit, np.zeros(len(recording)))
            )
            whole.values[mine] = curve.values
    return list(curves.values())


def _turned(field: Field, span: float) -> Field:
    """Return the field of the reversed morph, whose arrows point the other way."""
    return replace(
        field, positions=field.positions + field.displacement, displacement=-field.displacement,
        begin=span - field.end, end=span - field.begin,
    )  # fmt: skip


FORMATS = (
    Format(
        name="html", endings=(".html", ".htm"), write=write, read_metadata=read_metadata,
        signatures=((0, b"<!doctype"),), keep=True,
    ),
)  # fmt: skip
