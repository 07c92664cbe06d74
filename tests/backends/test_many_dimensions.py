"""Each operation on points of many coordinates, on each device against its NumPy twin."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

from clmorph.backends.interface import MAX_DIMENSION
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.constants import SLICE, SLICED_FROM
from clmorph.backends.opencl.build.variants import Variant, all_variants, used_together
from clmorph.backends.opencl.devices import verdicts
from clmorph.backends.opencl.verification.bench import Bench, Clouds, clustered
from clmorph.backends.opencl.verification.table import check_program, first_failure
from clmorph.backends.records import ProgramError

DIMENSIONS = [12, 17, 30, 128, pytest.param(MAX_DIMENSION, marks=pytest.mark.full)]
#: How coordinates are changed: by an offset, and by a scale.
PLACES = ((0.0, 1.0), (1e4, 1.0), (-3e7, 1e5), (5.0, 0.1))
#: The row loop's files: moments of many coordinates are many.
FILES = ("log_sum_exp.cl", "near_field.cl", "plan_rows.cl", "barycentric_projection.cl")
VARIANTS = [made for made in all_variants(SLICED_FROM) if made.file in FILES]


@dataclass(frozen=True)
class Small(Bench):
    """Clouds of two tiles and a part of one, whose exponents are of some tens, in some place."""

    place: tuple[float, float] = PLACES[0]

    def clouds(self, dimension=0, listed=False, columns=0):
        offset, scale = self.place
        both = (clustered(dimension, 70, 1), clustered(dimension, 133, 2))
        moved = [(offset + scale * points, weights) for points, weights in both]
        epsilon = 0.002 * dimension**0.5 * scale**2
        return [Clouds(*self.both, *moved, epsilon, f", {dimension}D at {self.place}")]


def expect(bench, variant):
    for finding in check_program(bench, variant):
        assert finding.passed, str(finding)


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_operations(variant, dimension):
    for made in VARIANTS:
        expect(Small(variant), replace(made, dimension=dimension))


@pytest.mark.parametrize("dimension", [17, 128])
def test_a_common_offset_or_another_unit_rounds_nothing(variant, dimension):
    for place, (precise, bounded) in product(PLACES, ((False, 0), (True, 0), (True, 1))):
        expect(
            Small(variant, place=place),
            Variant("log_sum_exp.cl", dimension, precise, False, bounded),
        )


@pytest.mark.parametrize("dimension", [12, 30])
def test_moments_and_draws(variant, dimension):
    for precise in (False, True):
        expect(Small(variant), Variant("plan_shares.cl", dimension, precise))


@pytest.mark.one_device
def test_one_program_serves_all_dimensions(variant):
    for made in all_variants(SLICED_FROM):
        macros = made.macros(variant.constants)
        assert "DIM" not in macros
        assert made.dimension == 0 or macros["SLICE"] == SLICE
    clouds = [variant.upload(*clustered(dimension, 9, 0)) for dimension in (12, 40)]
    kernels = [variant.row_loop.kernel("log_sum_exp.cl", "log_sum_exp", it) for it in clouds]
    assert kernels[0] is kernels[1]


@pytest.mark.one_device
def test_a_wrong_program_for_many_dimensions_is_refused_alone(each_device, monkeypatch):
    operations = OpenCLOperations(each_device.device)
    wrong = operations.programs._key(Variant("log_sum_exp.cl", SLICED_FROM))
    known = verdicts.load
    monkeypatch.setattr(
        verdicts, "load",
        lambda key: verdicts.Verdict(f"{verdicts.WRONG}it") if key == wrong else known(key),
    )  # fmt: skip
    points, weights = clustered(20, 30, 0)
    cloud = operations.upload(points, weights)
    with pytest.raises(ProgramError, match="cannot run this: wrong result of it; choose another"):
        operations.softmin(cloud, cloud, np.zeros(30), 0.1)
    few = operations.upload(points[:, :5], weights)
    assert np.isfinite(operations.softmin(few, few, np.zeros(30), 0.1)).all()


@pytest.mark.one_device
def test_a_slice_that_is_left_out_is_found(variant, monkeypatch):
    real = program.source
    monkeypatch.setattr(
        program, "source",
        lambda name: real(name).replace("first < dimension;", "first + SLICE <= dimension;"),
    )  # fmt: skip
    monkeypatch.setenv("PYOPENCL_NO_CACHE", "1")
    operations = OpenCLOperations(variant.device, verify=False)
    found = first_failure(operations, Variant("log_sum_exp.cl", SLICED_FROM))
    assert found.startswith(verdicts.WRONG)


def test_what_a_solve_uses_is_verified_together():
    solve = used_together(Variant("log_sum_exp.cl", SLICED_FROM))
    assert {made.bounded for made in solve} == {0, 1}
    alone = Variant("plan_rows.cl", SLICED_FROM)
    assert used_together(alone) == (alone,)
