"""Kernels for graphics cards stay within the table of registers and memory."""

import tomllib
from dataclasses import replace

import kernel_limits
import pytest
from programs import program

from clmorph.backends.opencl.build.constants import gpu_constants
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
    monkeypatch.setattr(kernel_limits, "CLANG", [program("clang-19"), *kernel_limits.CLANG[1:]])
    variant = Variant("sliced_ellpack.cl")
    found = kernel_limits.measure(target, variant)
    assert set(found) == set(KERNELS[variant.file])
    registers, spilled, _ = found["sum_stored"]
    assert (registers > 8, spilled) == (True, 0)
    named = {target: {f"{variant.file}:{name}": numbers for name, numbers in found.items()}}
    assert kernel_limits.complaints(named, LIMITS) == []


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_kernel_beyond_its_limits_is_told(place):
    """More registers, spills or local memory; and one that the table lacks."""
    limits = {"sm_90": {"a.cl:k": [32, 0, 512]}}
    found = [32, 0, 512]
    assert kernel_limits.complaints({"sm_90": {"a.cl:k": tuple(found)}}, limits) == []
    found[place] += 1
    (told,) = kernel_limits.complaints({"sm_90": {"a.cl:k": tuple(found)}}, limits)
    assert told.startswith(f"sm_90: a.cl:k takes {found[place]} ")
    (told,) = kernel_limits.complaints({"sm_90": {"b.cl:k": (1, 0, 0)}}, limits)
    assert told == "sm_90: b.cl:k has no limits"


def test_limits_of_slots_are_those_promised():
    """On an H100 and an MI200, for a pair of points in five dimensions."""
    assert SLOTS["sm_90"][0] <= 10
    assert SLOTS["sm_90"][1] <= 11.5
    assert SLOTS["gfx90a"][0] <= SLOTS["gfx90a"][1] <= 10
    assert max(words for *_, words in SLOTS.values()) <= 1.5


def test_nothing_is_spilled_on_cards():
    """The second number of each kernel is of bytes that are spilled or lie in memory."""
    assert {numbers[1] for kernels in LIMITS.values() for numbers in kernels.values()} == {0}


@pytest.mark.full
@pytest.mark.parametrize("target", kernel_limits.AMD)
def test_what_a_pair_takes_is_counted(target, monkeypatch):
    """From the loops that clang makes; with half as many rows a work-item reads twice as much."""
    monkeypatch.setattr(kernel_limits, "CLANG", [program("clang-19"), *kernel_limits.CLANG[1:]])
    found = kernel_limits.slots(target)
    assert all(n <= most + 0.05 for n, most in zip(found, SLOTS[target], strict=True))
    fewer = replace(gpu_constants(256), rows=2)
    monkeypatch.setattr(kernel_limits, "gpu_constants", lambda _: fewer)
    assert kernel_limits.slots(target)[2] == pytest.approx(2 * found[2])
