"""Checks of means over like neighbors, of paths along fields, and of drawn layers."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.comparison import UNIT, Finding
from clmorph.backends.interface import Operations
from clmorph.backends.numpy.layers import mean_radius
from clmorph.backends.records import TEAR, Affine, Float32, Float64, LayerView


class MeanCase(NamedTuple):
    """What a mean is taken of."""

    values: Float32
    weights: Float32
    guide: Float32
    fine_guide: Float32
    sigma: float
    tolerance: float

    def rounding(self) -> float:
        """Return the error that the mean may have.

        A likeness is rounded relative to its exponent, of which up to 30 matters: after that all
        cells count alike. Sums are rounded relative to their number of terms.
        """
        likeness = 24 * (8 + self.guide.shape[2]) + 16
        terms = (2 * mean_radius(self.sigma) + 1) ** 2
        return float(2 * UNIT * (likeness + terms) * np.abs(self.values).max())


def mean_cases(shape: tuple[int, int]) -> dict[str, MeanCase]:
    """Return means over cells themselves, and of more and of fewer points than cells."""
    rng = np.random.default_rng(6)
    height, width = shape

    def case(
        points: tuple[int, int] | None, channels: tuple[int, int], sigma: float, tolerance: float
    ) -> MeanCase:
        values, guide = (rng.normal(size=(*shape, many)).astype(np.float32) for many in channels)
        weights = rng.random(shape).astype(np.float32) ** 8
        weights[rng.random(shape) < 0.3] = 0.0
        fine = guide
        if points is not None:
            fine = rng.normal(size=(*points, channels[1])).astype(np.float32)
        return MeanCase(values, weights, guide, fine, sigma, tolerance)

    return {
        "cells": case(None, (5, 3), 3.3, 0.7),
        "more points": case((3 * height - 1, 2 * width + 3), (8, 8), 1.2, 2.0),
        "fewer points": case((height // 2 + 1, width // 3 + 1), (1, 1), 2.4, 0.05),
        "unlike cells": case((height + 1, width), (2, 4), 1.7, 0.01),
    }


def check_mean(
    operations: Operations, exact: Operations, shape: tuple[int, int] = (19, 26)
) -> Iterator[Finding]:
    """Compare means of random values over random colors."""
    for name, case in mean_cases(shape).items():
        got, want = (backend.edge_preserving_mean(*case) for backend in (operations, exact))
        error = largest(got - want) / case.rounding()
        yield Finding(f"edge_preserving_mean, {name}", error, 1.0, "of the tolerance")


class PathCase(NamedTuple):
    """What paths are followed along."""

    field: Float32
    to_field: Affine
    shape: tuple[int, int]
    steps: int
    rounds: int

    def rounding(self) -> float:
        """Return the error that paths may have, infinite where the field may fold.

        Each round halves the error before it, and adds half of what the field makes of it: with
        slopes below 1 it does not grow.
        """
        size = float(np.abs(self.field).max())
        slope = sum(
            float(np.abs(np.diff(self.field, axis=axis)).max(initial=0.0)) for axis in (0, 1)
        )
        return UNIT * (20 * size + 4 * slope * (size + 1)) / (1 - slope) if slope < 1 else np.inf


def path_cases(shape: tuple[int, int]) -> dict[str, PathCase]:
    """Return paths along smooth fields, inside and far outside, and along a folding one."""
    rows, columns = (np.linspace(0, 1, side) for side in shape)
    waves = [
        np.sin(5 * columns + k * rows[:, None] + k) * np.cos(3 * rows[:, None] - k * columns)
        for k in (1.0, 2.0)
    ]
    smooth = np.stack(waves, axis=-1)
    slope = sum(float(np.abs(np.diff(smooth, axis=axis)).max(initial=0.0)) for axis in (0, 1))
    smooth *= 0.6 / max(slope, 0.01)
    folding = np.random.default_rng(7).normal(0, 3.0, (*shape, 2))
    finer = shape[0] + 5, 2 * shape[1] + 3
    step = (shape[0] / finer[0], shape[1] / finer[1])
    inside = Affine((0.5 * step[0] - 0.5, 0.5 * step[1] - 0.5), step)
    return {
        "smooth": PathCase(smooth.astype(np.float32), inside, finer, 9, 4),
        "outside": PathCase(
            smooth.astype(np.float32), Affine((-9.3, 4e3), (1.7, -70.1)), finer, 3, 2
        ),
        "folding": PathCase(folding.astype(np.float32), inside, finer, 9, 4),
    }


def check_paths(
    operations: Operations, exact: Operations, shape: tuple[int, int] = (17, 35)
) -> Iterator[Finding]:
    """Compare paths along smooth fields; where a field folds, rounding decides their ways."""
    for name, case in path_cases(shape).items():
        got = operations.follow_paths(*case)
        if not np.isfinite(case.rounding()):
            # Each round takes a mean of displacements.
            most = (1 + 1e-5) * float(np.abs(case.field).max())
            outside = np.count_nonzero(~(np.abs(got) <= most))
            yield Finding(f"follow_paths, {name}", float(outside), 0.0, "places")
            continue
        error = largest(got - exact.follow_paths(*case)) / case.rounding()
        yield Finding(f"follow_paths, {name}", error, 1.0, "of the tolerance")


class LayerCase(NamedTuple):
    """A layer before it is uploaded; see `clmorph.backends.records.LayerView`."""

    coefficients: Float32
    paths: Float32
    change: Float32
    way: float
    to_paths: Affine
    to_field: Affine
    to_picture: Affine
    weights: Float32
    shares: Float32

    def view(self, operations: Operations) -> LayerView:
        """Return the layer as a backend draws it."""
        picture, layer = (
            operations.upload_spline(self.coefficients),
            operations.upload_layer(self.paths, self.change),
        )
        return LayerView(picture, layer, *self[3:])

    def rounding(self) -> float:
        """Return the error that the layer may have.

        The slope of a spline is at most the largest difference of coefficients, and that of a share
        of torn pixels follows from where tears begin.
        """
        color, changed, moved, weight = (
            float(np.abs(x).max())
            for x in (self.coefficients, self.change, self.paths, (self.weights, self.shares))
        )
        step = max(map(abs, self.to_picture.step))
        units = [abs(a * b) for a, b in zip(self.to_field.step, self.to_picture.step, strict=True)]
        changed *= self.way
        in_color = color * (40 * step * moved + 80) + changed * (48 * moved + 48)
        in_torn = 16 + (24 * step * moved + 4 * max(units) + 4) / (TEAR * max(*units, 1e-6))
        total = in_color + 2 * (color + changed) * in_torn
        return weight * UNIT * total


class Scene(NamedTuple):
    """What `Operations.draw_layers` takes, before it is uploaded."""

    layers: tuple[LayerCase, LayerCase]
    low: Float32
    shape: tuple[int, int]

    def draw(self, operations: Operations) -> NDArray[np.float32]:
        """Return the frame."""
        views = [layer.view(operations) for layer in self.layers]
        return operations.draw_layers(views, self.low, self.shape)

    def rounding(self) -> float:
        """Return the error that the frame may have."""
        low = float(np.abs(self.low).max())
        return 16 * UNIT * low + sum(layer.rounding() for layer in self.layers)


def scenes(shape: tuple[int, int]) -> dict[str, Scene]:
    """Return layers on a canvas: of small motions, of tears, far outside, of few points."""
    rng = np.random.default_rng(5)
    height, width = shape
    sizes = (height, width), (height // 2 + 1, width + 7)

    def over(few: tuple[int, int], many: tuple[int, int]) -> Affine:
        """Return how a grid of some shape lies on another one of the same extent."""
        steps = [a / b for a, b in zip(few, many, strict=True)]
        return Affine((0.5 * steps[0] - 0.5, 0.5 * steps[1] - 0.5), (steps[0], steps[1]))

    def layer(
        picture: tuple[int, int], way: float, motion: float, grid: tuple[int, int] = (7, 9),
        field: tuple[int, int] = (8, 6), share: float = 0.4,
    ) -> LayerCase:  # fmt: skip
        normal: list[Float64] = [
            rng.normal(size=size)
            for size in ((*picture, 4), (4, *grid, 2), (*field, 4))
        ]  # fmt: skip
        times = np.linspace(0, 1, 4)[:, None, None, None]
        return LayerCase(
            normal[0].astype(np.float32), (times * motion * normal[1]).astype(np.float32),
            normal[2].astype(np.float32), way, over(grid, shape), over(field, shape),
            over(picture, field), rng.random(grid).astype(np.float32),
            (share * rng.integers(0, 3, grid)).astype(np.float32),
        )  # fmt: skip

    def moved(case: LayerCase, origin: float, step: float) -> LayerCase:
        return case._replace(
            to_picture=Affine((origin, -2 * origin), (-step, step)),
            to_field=Affine((-origin, origin), case.to_field.step),
        )

    low = rng.normal(size=(5, 4, 4)).astype(np.float32)
    near = layer(sizes[0], 0.37, 0.2), layer(sizes[1], 0.63, 0.1, (height, width), (3, 17), 0.6)
    torn = layer(sizes[0], 0.85, 1.5), layer(sizes[1], 1.0, 0.8, share=-0.3)
    ends = layer(sizes[0], 0.0, 3.0, share=1.0), layer(sizes[0], 1.0, 3.0, share=0.0)
    far = tuple(moved(case, 4.0 * max(shape), 3.1) for case in near)
    points = layer((1, 1), 0.4, 1.0, (1, 1), (1, 1)), layer((1, 5), 0.6, 0.5, (1, 3), (2, 1))
    return {
        "near": Scene(near, low, shape),
        "torn": Scene(torn, low, shape),
        "both ends": Scene((ends[0], ends[1]), low, shape),
        "far": Scene((far[0], far[1]), low[:1], shape),
        "points": Scene(points, low[:1, :1], shape),
    }


def check_layers(
    operations: Operations, exact: Operations, shape: tuple[int, int] = (45, 70)
) -> Iterator[Finding]:
    """Compare frames of two random layers."""
    for name, scene in scenes(shape).items():
        error = largest(scene.draw(operations) - scene.draw(exact)) / scene.rounding()
        yield Finding(f"draw_layers, {name}", error, 1.0, "of the tolerance")


def largest(differences: Float32 | Float64) -> float:
    """Return the largest difference; infinite if one is not a number."""
    return float(np.nan_to_num(np.abs(differences), nan=np.inf).max())
