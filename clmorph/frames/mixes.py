"""Draw mixtures of several pictures: one picture at each place, each moved towards all others.

With the weights w, picture i is moved by sum_j w_j v_ij, where v_ij is its field in the morph of
pictures i and j (`clmorph.frames.layers`). With two pictures this is a frame of their morph. The
result does not depend on a reference among them. Lee, Wolberg and Shin mix warps in this way
("Polymorph: morphing among multiple images", IEEE Computer Graphics and Applications 18(1), 1998).
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas
from clmorph.frames.ends import End
from clmorph.frames.fields import Field, Layer, layer_of, sampled
from clmorph.frames.figures import figures_of
from clmorph.frames.layers import Layers, follow
from clmorph.frames.pictures import Pictures
from clmorph.frames.switching import turns
from clmorph.measures.measure import Measure


def mixed_canvas(pictures: Sequence[End], weights: Sequence[float]) -> Canvas:
    """Return the canvas of a mixture, whose sides are the weighted means of those of the images."""
    # The small number keeps rounding from turning an integer into the one below.
    sides = np.array([picture.shape for picture in pictures])
    height, width = np.floor(np.array(weights) @ sides + 1e-9).astype(int).tolist()
    if pictures[0].extent == "unit":
        return Canvas((height, width), (width - 1.0, height - 1.0))
    per_unit = float(np.array(weights) @ (sides.max(axis=1) - 1))
    return Canvas((height, width), (per_unit, per_unit))


class MixRenderer:
    """Draws mixtures of pictures from the layers of the morph of each pair (i, j), i < j."""

    def __init__(
        self,
        ends: Sequence[End],
        measures: Sequence[Measure],
        layers: Mapping[tuple[int, int], Layers],
        path_space: str,
        operations: Operations,
    ) -> None:
        self._ends, self._layers, self._operations = ends, layers, operations
        self._pictures = Pictures(ends, figures_of(measures, ends), path_space, operations)

    def frame(self, weights: Sequence[float]) -> NDArray[np.floating]:
        """Draw a mixture by weights of sum 1: (H, W, 3) sRGB array, or (H, W, 4) with opacity."""
        stage = self._pictures.stage
        points = stage.positions()
        found, total = np.zeros((*stage.shape, 3)), 0.0
        for (i, j), pair in self._layers.items():
            weight = weights[i] * weights[j]
            shown = np.dstack((pair.times, pair.agreement, pair.thin))
            found += weight * sampled(shown, pair.stage.places(points))
            total += weight
        times, agreement, thin = np.moveaxis(found / max(total, 1e-12), -1, 0)
        return self._pictures.frame(
            [self._layer(i, weights) for i in range(len(weights))],
            [1.0] * len(weights),
            weights,
            turns(times, agreement, weights),
            agreement,
            thin,
            mixed_canvas(self._ends, weights),
        )

    def _layer(self, i: int, weights: Sequence[float]) -> Layer:
        """Return a picture on its whole way to its place in a mixture."""
        parts: list[tuple[float, Field]] = []
        for j, weight in enumerate(weights):
            if j != i:
                pair = self._layers[min(i, j), max(i, j)]
                parts.append((weight, pair.fields[int(i > j)]))
        field = parts[0][1]._replace(
            move=np.sum([weight * part.move for weight, part in parts], axis=0),
            change=np.sum([weight * part.change for weight, part in parts], axis=0),
        )
        paths = follow(field, self._pictures.stage, self._operations)
        # A layer that is wholly on its way needs the last step alone, after its start.
        return layer_of(field, paths[[0, -1]], self._operations)
