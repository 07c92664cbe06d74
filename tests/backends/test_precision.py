"""Exponents in more than float32 have the stated accuracy, and are used only where needed."""

from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from clouds import drawings
from residuals import true_residual

import clmorph
from clmorph import ConvergenceWarning, DeviceError, lift, sinkhorn
from clmorph.backends.opencl import probe
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.constants import apply_quirks, choose_constants
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.devices.quirks import find_quirks
from clmorph.backends.opencl.devices.verdicts import Verdict, forget, save, verdict_key
from clmorph.backends.opencl.verification.bench import log_sum_exp_tolerance
from clmorph.reference import NumPyOperations

REFERENCE = NumPyOperations()


@pytest.fixture(params=["float64", "no_float64", "slow_float64"])
def precise_device(request, device):
    """Each device with float64, without, and with float64 for little but iterations."""
    quirks = frozenset({request.param} - {"float64"})
    constants = apply_quirks(choose_constants(device.device), quirks)
    return OpenCLOperations(device.device, constants, verify=False)


@pytest.mark.parametrize("color_weight", [1.0, 4.0])
@pytest.mark.parametrize("blur", [1.0, 0.1, 0.05, 0.03, 0.01, 0.003])
def test_one_log_sum_exp(precise_device, rng, blur, color_weight):
    """Float32 within 1e-4 nats + 3e-8 max C / epsilon; precise within 1e-5 at any blur."""
    source, target = (lift(picture, color_weight) for picture in drawings(32))
    epsilon = blur**2
    g = 0.1 * rng.random() + epsilon * rng.normal(size=len(target))
    pairs = [
        [backend.upload(cloud.points, cloud.weights) for cloud in (source, target)]
        for backend in (precise_device, REFERENCE)
    ]
    want = REFERENCE.softmin(*pairs[1], g, epsilon)
    coarse = precise_device.softmin(*pairs[0], g, epsilon)
    largest = clmorph.transport._solver.problem.largest_cost(source.points, target.points) / epsilon
    assert np.abs(coarse - want).max() / epsilon <= 1e-4 + 3e-8 * largest
    fine = precise_device.softmin(*pairs[0], g, epsilon, True)
    bound = log_sum_exp_tolerance(
        precise_device, (source.points, source.weights), (target.points, target.weights),
        epsilon, True,
    )  # fmt: skip
    assert np.abs(fine - want).max() / epsilon <= min(bound, 1e-5)


@pytest.mark.parametrize(("blur", "tol"), [(0.05, 1e-4), (0.01, 1e-4), (0.003, 1e-3)])
def test_the_solve_reaches_what_is_asked(precise_device, blur, tol):
    source, target = (lift(picture) for picture in drawings(20))
    got = sinkhorn(source, target, blur, 0.3, tol, 5000, precise_device)
    assert got.converged
    assert got.residual <= tol
    assert true_residual((source, target), got) <= 1.05 * tol


def test_more_than_float32_is_taken_only_where_needed(precise_device, monkeypatch):
    source, target = (lift(picture) for picture in drawings(20))
    asked = []
    softmin = precise_device.softmin

    def watch(rows, columns, potential, epsilon, precise=False, near=None):
        asked.append(precise)
        return softmin(rows, columns, potential, epsilon, precise, near)

    monkeypatch.setattr(precise_device, "softmin", watch)
    # Iterations on the device ask for no single softmins.
    monkeypatch.setattr(precise_device, "start_iteration", lambda *arguments: None)
    bounded, bounded_softmin = [], precise_device.bounded_softmin
    monkeypatch.setattr(
        precise_device,
        "bounded_softmin",
        lambda *arguments: bounded.append(1) or bounded_softmin(*arguments),
    )
    assert not sinkhorn(source, target, 0.1, 0.3, 1e-2, backend=precise_device).precise
    assert not any(asked)
    assert len(bounded) == 2  # the certificate
    asked.clear()
    assert sinkhorn(source, target, 0.01, 0.3, 1e-4, 5000, precise_device).precise
    assert 10 < sum(asked) < len(asked)  # the annealing is not
    asked.clear()
    sinkhorn(source, target, 0.1, 0.3, 1e-2, backend=precise_device, precision="float32")
    assert not any(asked)
    assert len(bounded) == 6


def test_float64_is_taken_or_refused(precise_device):
    source, target = (lift(picture) for picture in drawings(12))
    if precise_device.has_float64:
        got = sinkhorn(source, target, 0.05, backend=precise_device, precision="float64")
        assert got.converged
    else:
        with pytest.raises(DeviceError, match="no double precision"):
            sinkhorn(source, target, 0.05, backend=precise_device, precision="float64")


@pytest.mark.parametrize(("precision", "tol"), [("float32", 1e-5), ("auto", 1e-12)])
def test_a_tolerance_below_rounding_is_answered_so(device, precision, tol):
    source, target = (lift(picture) for picture in drawings(20))
    with pytest.warns(ConvergenceWarning, match=r"rounding can leave .*raise tol or blur"):
        got = sinkhorn(
            source, target, 0.03, 0.3, tol, 10**6, backend=device, precision=precision
        )  # fmt: skip
    assert got.status == "precision"
    assert got.n_iter < 300
    assert true_residual((source, target), got) < 1e-3


@pytest.mark.parametrize("factor", [1 / 32, 1.0, 1.1, 2.0])
def test_float64_is_for_cards_on_which_it_is_fast(device, monkeypatch, factor):
    """By rates of sums with precise exponents; those of the pairs are `factor` times as high."""
    monkeypatch.delenv("CLMORPH_QUIRKS", raising=False)
    rated = []

    def rate(_, constants):
        rated.append(constants.precise)
        return 1e9 if constants.precise == 2 else factor * 1e9

    monkeypatch.setattr(probe, "precise_rate", rate)
    wanted = choose_constants(device.device)
    monkeypatch.setattr(probe, "choose_constants", lambda _: replace(wanted, precise=2))
    with monkeypatch.context() as patch:
        patch.setattr(cl.Device, "type", property(lambda _: cl.device_type.GPU))
        made = probe._with_faster_exponents(device.device)
    assert made == replace(wanted, precise=1 if factor > 1.2 else 2)
    assert sorted(rated) == [1, 2]
    assert probe._with_faster_exponents(device.device).precise == 2
    assert len(rated) == 2


def test_rates_with_precise_exponents_are_measured(device):
    assert 1e3 < probe.precise_rate(device.device, device.constants) < 1e13


def test_slow_float64_is_remembered(device, empty_cache):
    """With the verdict, which a forgotten one takes along; iterations remain the device's."""
    if not device.has_float64:
        pytest.skip("it has no float64")
    key = verdict_key(device.device)
    save(key, Verdict(slow_float64=True))
    assert "slow_float64" in find_quirks(device.device)
    constants = choose_constants(device.device)
    assert (constants.precise, constants.float64) == (1, 1)
    assert Variant("half_steps.cl").suits(constants) == (not constants.longest_loop)
    forget(key)
    assert choose_constants(device.device).precise == 2


def test_precise_plan_rows(precise_device):
    """At a small blur float32 exponents alone are off by more."""
    source, target = (lift(picture) for picture in drawings(20))
    potentials = sinkhorn(source, target, 0.003, 0.3, 1e-3, 5000, precise_device)
    plan = clmorph.transport_plan(source, target, potentials, backend=precise_device)
    assert potentials.precise
    exact = clmorph.reference.transport_plan(source, target, potentials)
    kept = exact[plan.rows, plan.indices]
    assert np.abs(plan.mass / kept - 1).max() < 2e-4
