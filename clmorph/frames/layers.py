"""Frames that show one picture at each place: two layers, drawn backwards along their fields.

Each picture is moved and recolored along the plan by its own field (`fields`), so that at time t
both layers show the masses and colors of the interpolation. A pixel of a layer shows its picture at
the place that it has followed since the picture's own end (`Operations.follow_paths`): nothing
has holes or jumps. Where both layers agree (`registration`) they are mixed, which is a warp.
Elsewhere one of them is seen, and the place changes hands within a short part of the film
(`switching`), after "Regenerative Morphing" (Shechtman et al., CVPR 2010).

Where the pictures are frames of clips, the fields of a pair belong to its `Moment`. Between two
moments they are mixed by time, point by point, and so are the places where both pictures agree and
the times at which places change hands: all of these are continuous, so that nothing jumps where a
pair is solved.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas
from clmorph.frames.ends import End
from clmorph.frames.fields import Field, affine, field_of, layer_of
from clmorph.frames.figures import figures_of
from clmorph.frames.outline import thinness
from clmorph.frames.particles import Particles
from clmorph.frames.pictures import MET, Pictures
from clmorph.frames.registration import PATH_ROUNDS, STEPS, Scene
from clmorph.frames.resampling import Float32, reduced
from clmorph.frames.switching import switched, switching_times
from clmorph.measures.measure import Measure

#: Points of the stage around a figure in which its edge may be that of the pictures.
RIM = 2.0
#: Half change of color at which both pictures hardly count as equal there.
EQUAL = 0.2


class Layers:
    """Both layers of a morph.

    `fields` are how each picture moves to the other end. `stage` is the grid of three (h, w)
    arrays: `agreement` and `thin`, how far both pictures agree and have but thin lines at t = 1/2,
    from 0 to 1, and `times`, when each place changes hands (`clmorph.frames.switching`).
    Without `outlined` no figure stands before a ground.
    """

    def __init__(
        self,
        ends: tuple[End, End],
        measures: tuple[Measure, Measure],
        particles: Particles,
        operations: Operations,
        *,
        outlined: bool = True,
    ) -> None:
        self._operations = operations
        figures = figures_of(measures, ends) if outlined else None
        pictures = Pictures(ends, figures, particles.path_space, operations)
        self._pictures = pictures
        self.stage = pictures.stage
        fields = [
            field_of(
                particles, end, measures, pictures.continued[end], pictures.cells[1 - end],
                pictures.canvases, operations, figure=figures is not None,
            )
            for end in (0, 1)
        ]  # fmt: skip
        scene = Scene(fields, pictures, operations)
        if figures is not None:
            scene.meet_outlines()
        self.agreement = scene.meet_details()
        self.fields = scene.fields
        halves = scene.halves()
        shared, self.thin = None, np.zeros(self.stage.shape)
        if figures is not None:
            # The ground is drawn by itself.
            first, second = (half.outline for half in halves)
            within = np.maximum(first, second)
            shared = np.clip((np.minimum(first, second) + RIM) / RIM, 0.0, 1.0)
            self.thin, _ = thinness([first, second])
            self.agreement = self.agreement * np.clip((within + 2 * RIM) / RIM, 0.0, 1.0)
            # Outlines that are apart are seen twice in a mixture.
            near = [np.clip(outline, -2 * RIM, 2 * RIM) for outline in (first, second)]
            self.agreement = self.agreement * np.exp(-(((near[0] - near[1]) / MET) ** 2))
            apart = np.abs(first - second)[np.abs(first + second) < 2 * RIM]
            pictures.smoothing = min(1.0, float(apart.mean())) if apart.size else 0.0
            # Edges that change their color are mixtures with the ground, which does not.
            for half in halves:
                change = np.linalg.norm(half.change, axis=2)
                self.agreement = self.agreement * np.exp(-((change / EQUAL) ** 2))
        self.times = switching_times(
            [half.colors for half in halves],
            pictures.lightness,
            self.stage,
            operations,
            shared=shared,
            thin=self.thin,
        )
        self._paths = [follow(field, self.stage, operations) for field in self.fields]
        self._upload()

    def _upload(self) -> None:
        self._layers = [
            layer_of(field, paths, self._operations)
            for field, paths in zip(self.fields, self._paths, strict=True)
        ]

    def on(self, operations: Operations) -> Layers:
        """Return the same layers for another device."""
        other = copy(self)
        other._operations, other._pictures = operations, self._pictures.on(operations)
        other._upload()
        return other

    @property
    def exact(self) -> bool:
        """Whether the first and the last frame are the pictures, without a correction."""
        return self._pictures.figures is None

    def frame(self, t: float, canvas: Canvas) -> NDArray[np.floating]:
        """Return a frame: (H, W, 3) array of sRGB, or (H, W, 4) with opacity."""
        second = switched(self.times, self.agreement, t)
        return self._pictures.frame(
            self._layers, (t, 1 - t), (1 - t, t), (1 - second, second), self.agreement, self.thin,
            canvas,
        )  # fmt: skip


def follow(field: Field, stage: Canvas, operations: Operations) -> Float32:
    """Return the paths along a field, from all points of a stage."""
    return operations.follow_paths(
        field.steps(), affine(stage, field.canvas), stage.shape, STEPS, PATH_ROUNDS
    )


class Moment(NamedTuple):
    """What is known of two moving pictures at one moment; see `Layers`."""

    fields: tuple[Field, ...]
    agreement: Array
    times: Array

    def towards(self, other: Moment, share: float) -> Moment:
        """Return the moment at a share, from 0 to 1, of the time to another one."""

        def mixed(first: Array, second: Array) -> Array:
            return first + share * (second - first)

        fields = tuple(
            one._replace(move=mixed(one.move, two.move), change=mixed(one.change, two.change))
            for one, two in zip(self.fields, other.fields, strict=True)
        )
        return Moment(
            fields, mixed(self.agreement, other.agreement), mixed(self.times, other.times)
        )

    def frame(
        self, t: float, pictures: tuple[Array, Array], canvas: Canvas, extent: str, space: str,
        operations: Operations,
    ) -> NDArray[np.floating]:  # fmt: skip
        """Draw two opaque pictures, (H, W, 3) each, on a canvas at the time t of their film."""
        ends = [End(picture, None, extent) for picture in pictures]
        drawn = Pictures(ends, None, space, operations)
        layers = [
            layer_of(
                field._replace(guide=reduced(own, field.canvas.shape)),
                follow(field, drawn.stage, operations), operations,
            )
            for field, own in zip(self.fields, drawn.own, strict=True)
        ]  # fmt: skip
        second = switched(self.times, self.agreement, t)
        thin = np.zeros(drawn.stage.shape)  # figures alone are lines
        return drawn.frame(
            layers, (t, 1 - t), (1 - t, t), (1 - second, second), self.agreement, thin, canvas
        )
