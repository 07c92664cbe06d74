"""Kernels for graphics cards stay within the table of registers and memory."""

import tomllib

import kernel_limits
import pytest
from programs import program

from clmorph.backends.opencl.build.variants import KERNELS, Variant

LIMITS = tomllib.loads(kernel_limits.TABLE.read_text(encoding="utf-8"))
SLOTS = LIMITS.pop("slots")


def test_the_table_has_every_kernel():
    wanted = {f"{file}:{kernel}" for file, kernels in KERNELS.items() for kernel in kernels}
    assert set(LIMITS) == set(kernel_limits.TARGETS)
    for kernels in LIMITS.values():
        assert set(kernels) == wanted


@pytest.mark.parametrize("target", kernel_limits.AMD)
def test_compiled_kernels_are_within_it(target, monkeypatch):
    """CI runs the tool on all kernels and targets."""
    monkeypatch.setattr(kernel_limits, "CLANG", [program("clang"), *kernel_limits.CLANG[1:]])
    variant = Variant("sliced_ellpack.cl")
    found = kernel_limits.measure(target, variant)
    assert set(found) == set(KERNELS[variant.file])
    registers, spilled, _ = found["sum_stored"]
    assert (registers > 8, spilled) == (True, 0)
    named = {target: {f"{variant.file}:{name}": numbers for name, numbers in found.items()}}
    assert kernel_limits.complaints(named, LIMITS) == []


def test_limits_of_slots_are_those_promised():
    """On an H100 and an MI200, for a pair of points in five dimensions."""
    assert SLOTS["sm_90"][0] <= 10
    assert SLOTS["sm_90"][1] <= 11.5
    assert SLOTS["gfx90a"][0] <= SLOTS["gfx90a"][1] <= 10


def test_slots_are_those_of_the_innermost_loops():
    around = ["\ts_nop 0", ".LBB0_1:", "\tv_exp_f32_e32 v0, v1"]
    inside = [".LBB0_2:", "\tv_add_f32_e32 v0, v1", "\tv_exp_f32_e32 v0, v1"]
    others = [".LBB0_3:", "\tv_exp_f32_e32 v0, v1", "\ts_cbranch_scc1 .LBB0_3"]
    ends = ["\ts_cbranch_scc1 .LBB0_2", *others, "\ts_cbranch_scc0 .LBB0_1", "\ts_endpgm"]
    loops = kernel_limits.innermost("\n".join([*around, *inside, *ends]))
    assert loops == [
        [line.strip() for line in others[1:]],
        [line.strip() for line in (*inside[1:], ends[0])],
    ]


@pytest.mark.parametrize("place", range(3))
def test_a_kernel_that_passes_its_limits_is_told(place):
    numbers = [24, 0, 512]
    limits = {"sm_90": {"a.cl:b": list(numbers)}}
    assert kernel_limits.complaints({"sm_90": {"a.cl:b": tuple(numbers)}}, limits) == []
    numbers[place] += 1
    (said,) = kernel_limits.complaints({"sm_90": {"a.cl:b": tuple(numbers)}}, limits)
    assert f"takes {numbers[place]}" in said
    (said,) = kernel_limits.complaints({"sm_80": {"a.cl:c": tuple(numbers)}}, limits)
    assert said == "sm_80: a.cl:c has no limits"
