"""One layer: a picture with its paths, and how its outline is led to that of a frame.

The outline of a figure on its way is a mean of those of both layers. A line along a layer's own
outline would be cut off where the frame's runs inside of it, and would be as broad as the gap where
it runs outside. So near its outline a layer is displaced by the gap, along its distance's slope.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas
from clmorph.frames.fields import Field, affine, blurred, sampled, slopes
from clmorph.frames.resampling import Float32

#: Shares of the stage's longer side: the depth below an outline to which it takes its layer along,
#: beside 1.5 gaps, and the gap that is too far to be closed.
DEPTH, FAR = 0.024, 0.06
GAPS = 1.5
#: Points of the stage by which outlines that meet differ.
CLOSE = 1.5
#: Least squared slope of a distance by which a gap is divided; its ridges have none.
LEAST_SLOPE = 0.25


class Layer(NamedTuple):
    """What moves one picture; the handle is that of `Operations.upload_layer`."""

    field: Field
    paths: Float32  # (steps + 1, h, w, 2), see `Operations.follow_paths`
    handle: Any

    def moved(self, way: float) -> Array:
        """Return how far each point of the stage is displaced on the field: (h, w, 2) array."""
        last = len(self.paths) - 1
        step = min(int(way * last), last - 1)
        first, second = self.paths[step : step + 2].astype(np.float64)
        return np.asarray(first + (way * last - step) * (second - first))


def layer_of(field: Field, paths: Float32, operations: Operations) -> Layer:
    """Upload a layer."""
    change = np.zeros((*field.canvas.shape, 8), np.float32)
    change[..., :3], change[..., 4:7] = field.change, field.guide
    return Layer(field, paths, operations.upload_layer(paths, change))


def led_to(
    layer: Layer, distance: Array, outline: Array, way: float, stage: Canvas, operations: Operations
) -> Layer:
    """Return a layer whose outline is led to another one, at one share of its way.

    `distance` and `outline`, (h, w), are the signed distances from both in points of the stage.
    """
    longest = max(stage.shape)
    gap = blurred(outline - distance, 1.0)
    slope = np.stack(slopes(blurred(distance, 1.0)), axis=-1)
    steep = np.maximum((slope**2).sum(axis=-1), LEAST_SLOPE)
    near = np.exp(-((outline / (DEPTH * longest + GAPS * np.abs(gap))) ** 2))
    # Outlines that meet stay where they are.
    near *= np.exp(-((gap / (FAR * longest)) ** 2)) * (1.0 - np.exp(-((gap / CLOSE) ** 2)))
    shift = blurred(slope * (near * gap / steep)[..., None], 1.0)
    places = np.indices(stage.shape) + np.moveaxis(shift, -1, 0)
    moved = sampled(layer.moved(way), places)
    moved += shift * affine(stage, layer.field.canvas).step
    # Both steps are this one, so that it is drawn at any share of the way.
    return layer_of(layer.field, np.stack([moved, moved]).astype(np.float32), operations)
