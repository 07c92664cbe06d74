"""Checks of means over like neighbors, of paths along fields, and of drawn layers."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.numpy.layers import mean_radius, with_steepness
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.verification.bench import Bench, Findings, check
from clmorph.backends.opencl.verification.findings import UNIT, Finding, largest
from clmorph.backends.records import LIKE, TEAR, Affine, Float32, LayerView

Shape = tuple[int, int]


def _over(few: Shape, many: Shape) -> Affine:
    """Return how a grid of some shape lies on another one of the same extent."""
    step = few[0] / many[0], few[1] / many[1]
    return Affine((0.5 * step[0] - 0.5, 0.5 * step[1] - 0.5), step)


class MeanCase(NamedTuple):
    """What a mean is taken of."""

    values: Float32
    weights: Float32
    guide: Float32
    fine_guide: Float32
    sigma: float
    tolerance: float

    def rounding(self) -> float:
        """Return the error that the mean may have."""
        # A likeness is rounded relative to its exponent, of which up to 30 matters.
        likeness = 24 * (8 + self.guide.shape[2]) + 16
        terms = (2 * mean_radius(self.sigma) + 1) ** 2
        return float(2 * UNIT * (likeness + terms) * np.abs(self.values).max())


def mean_cases(shape: Shape) -> dict[str, MeanCase]:
    """Return means over cells themselves, and of more and of fewer points than cells."""
    rng = np.random.default_rng(6)
    height, width = shape

    def case(points: Shape | None, channels: Shape, sigma: float, tolerance: float) -> MeanCase:
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


@check("layers.cl", "edge_preserving_mean")
def means(bench: Bench, variant: Variant) -> Findings:
    """Compare means of random values over random colors."""
    for name, case in mean_cases((37, 52) if bench.pictures else (19, 26)).items():
        got, want = (backend.edge_preserving_mean(*case) for backend in bench.both)
        yield Finding(f"edge_preserving_mean, {name}", largest(got - want) / case.rounding())


class PathCase(NamedTuple):
    """What paths are followed along."""

    field: Float32
    to_field: Affine
    shape: Shape
    steps: int
    rounds: int

    def slope(self) -> float:
        """Return the sum of the field's largest slopes along the axes."""
        return sum(largest(np.diff(self.field, axis=axis)) for axis in (0, 1))

    def rounding(self) -> float:
        """Return the error that paths may have, infinite where the field may fold."""
        # With slopes d and a steepness s, a round keeps (s + d) / (1 + s) of the error before it.
        size, slope = largest(self.field), self.slope()
        steep = 1 + largest(with_steepness(self.field)[..., 2])
        each = UNIT * (20 * size + 4 * slope * (size + 1))
        return each * steep / (1 - slope) if slope < 1 else np.inf


def path_cases(shape: Shape) -> dict[str, PathCase]:
    """Return paths along smooth fields, inside and far outside, and along a folding one."""
    y, x = np.meshgrid(*(np.linspace(0, 1, side) for side in shape), indexing="ij")
    waves = [np.sin(5 * x + k * y + k) * np.cos(3 * y - k * x) for k in (1.0, 2.0)]
    finer = shape[0] + 5, 2 * shape[1] + 3
    smooth = PathCase(np.stack(waves, -1).astype(np.float32), _over(shape, finer), finer, 9, 4)
    smooth = smooth._replace(field=smooth.field * np.float32(0.6 / max(smooth.slope(), 0.01)))
    away = Affine((-9.3, 4e3), (1.7, -70.1))
    folding = np.random.default_rng(7).normal(0, 3.0, (*shape, 2)).astype(np.float32)
    return {
        "smooth": smooth,
        "outside": smooth._replace(to_field=away, steps=3, rounds=2),
        "folding": smooth._replace(field=folding),
    }


@check("layers.cl", "follow_paths")
def paths(bench: Bench, variant: Variant) -> Findings:
    """Compare paths along smooth fields; where a field folds, rounding decides their ways."""
    for name, case in path_cases((61, 83) if bench.pictures else (17, 35)).items():
        got = bench.operations.follow_paths(*case)
        if np.isfinite(case.rounding()):
            error = largest(got - bench.exact.follow_paths(*case)) / case.rounding()
        else:
            # Each round takes a mean of displacements.
            error = largest(got) / ((1 + 1e-5) * largest(case.field))
        yield Finding(f"follow_paths, {name}", error)


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
        picture = operations.upload_spline(self.coefficients)
        layer = operations.upload_layer(self.paths, self.change)
        return LayerView(picture, layer, *self[3:])

    def rounding(self) -> float:
        """Return the error that the layer may have."""
        # A spline's slope is at most the largest difference of its coefficients.
        color, moved = map(largest, (self.coefficients, self.paths))
        changed = largest(self.change[..., :4])
        step = max(map(abs, self.to_picture.step))
        units = [abs(a * b) for a, b in zip(self.to_field.step, self.to_picture.step, strict=True)]
        changed *= self.way
        in_picture = color * (40 * step * moved + 80)
        in_color = in_picture * (1 + 2 / LIKE * changed) + changed * (48 * moved + 48)
        in_torn = 16 + (24 * step * moved + 4 * max(units) + 4) / (TEAR * max(*units, 1e-6))
        total = in_color + 2 * (color + changed) * in_torn
        return max(map(largest, (self.weights, self.shares))) * UNIT * total


class Scene(NamedTuple):
    """What `Operations.draw_layers` takes, before it is uploaded."""

    layers: tuple[LayerCase, LayerCase]
    low: Float32
    shape: Shape

    def draw(self, operations: Operations, rows: slice | None = None) -> NDArray[np.float32]:
        """Return the frame, or some rows of it."""
        views = [layer.view(operations) for layer in self.layers]
        return operations.draw_layers(views, self.low, self.shape, rows)

    def rounding(self) -> float:
        """Return the error that the frame may have."""
        return 16 * UNIT * largest(self.low) + sum(layer.rounding() for layer in self.layers)


def scenes(shape: Shape) -> dict[str, Scene]:
    """Return layers on a canvas: of small motions, of tears, far outside, of few points."""
    rng = np.random.default_rng(5)
    (height, width), whole, part = shape, shape, (shape[0] // 2 + 1, shape[1] + 7)

    def layer(
        picture: Shape, way: float, motion: float, grid: Shape = (7, 9), field: Shape = (8, 6),
        share: float = 0.4,
    ) -> LayerCase:  # fmt: skip
        coefficients, paths, change = (
            rng.normal(size=size).astype(np.float32)
            for size in ((*picture, 4), (4, *grid, 2), (*field, 8))
        )
        # Colors of which some count as like.
        coefficients *= LIKE
        change[..., 4:] *= LIKE
        paths *= motion * np.linspace(0, 1, 4, dtype=np.float32)[:, None, None, None]
        return LayerCase(
            coefficients, paths, change, way, _over(grid, shape), _over(field, shape),
            _over(picture, field), rng.random(grid).astype(np.float32),
            (share * rng.integers(0, 3, grid)).astype(np.float32),
        )  # fmt: skip

    def away(case: LayerCase) -> LayerCase:
        origin = 4.0 * max(shape)
        return case._replace(
            to_picture=Affine((origin, -2 * origin), (-3.1, 3.1)),
            to_field=Affine((-origin, origin), case.to_field.step),
        )

    low = rng.normal(size=(5, 4, 4)).astype(np.float32)
    near = layer(whole, 0.37, 0.2), layer(part, 0.63, 0.1, (height, width), (3, 17), 0.6)
    torn = layer(whole, 0.85, 1.5), layer(part, 1.0, 0.8, share=-0.3)
    ends = layer(whole, 0.0, 3.0, share=1.0), layer(whole, 1.0, 3.0, share=0.0)
    points = layer((1, 1), 0.4, 1.0, (1, 1), (1, 1)), layer((1, 5), 0.6, 0.5, (1, 3), (2, 1))
    return {
        "near": Scene(near, low, shape),
        "torn": Scene(torn, low, shape),
        "both ends": Scene(ends, low, shape),
        "far": Scene((away(near[0]), away(near[1])), low[:1], shape),
        "points": Scene(points, low[:1, :1], shape),
    }


@check("layers.cl", "place_layer", "draw_layers")
def layers(bench: Bench, variant: Variant) -> Findings:
    """Compare frames of two random layers."""
    for name, scene in scenes((150, 211) if bench.pictures else (45, 70)).items():
        got, want = (scene.draw(backend) for backend in bench.both)
        yield Finding(f"draw_layers, {name}", largest(got - want) / scene.rounding())
