"""Estimate the time of frames, and of a plan that was not built, from measurements on a sample."""

from dataclasses import replace
from time import perf_counter

import numpy as np

from clmorph._shared.typing import IntArray
from clmorph.backends.interface import Operations
from clmorph.backends.records import PlanTerms
from clmorph.frames.frame_renderer import FrameRenderer
from clmorph.frames.kernel_width import KernelWidth
from clmorph.frames.options import Detail, RenderOptions
from clmorph.frames.particles import particles
from clmorph.images.detail import auto_sigma
from clmorph.measures.measure import Measure
from clmorph.measures.points import as_pair
from clmorph.pipeline.budget import sampled_part
from clmorph.pipeline.film import picture_of
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport._solver.problem import uploaded
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan
from clmorph.transport.plan_sampling import sample_plan
from clmorph.transport.potentials import Potentials

#: Labels of the pixels of both images.
Labels = tuple[IntArray, IntArray] | None
#: The largest number of pairs that are drawn; the time of more pairs is extrapolated from this
#: number and a quarter of it.
SAMPLED_PAIRS = 1 << 20
#: Times at which frames are drawn, the number of passes, and the weight of each time.
PASSES = 2
TIMES, SHARES = (0.0, 0.25, 0.5, 0.75, 1.0), (0.125, 0.25, 0.25, 0.25, 0.125)


def frame_seconds(
    source: Measure,
    target: Measure,
    potentials: Potentials,
    plan: Plan | Barycentric | None,
    pairs: int,
    n_frames: int,
    operations: Operations,
    detail: Detail = RenderOptions.detail,
    labels: Labels = None,
) -> float:
    """Estimate the seconds of making particles of a plan of `pairs` and drawing frames by them."""
    if plan is None:
        draws = max(1, min(4096, SAMPLED_PAIRS // len(source)))
        plan = sample_plan(source, target, potentials, draws, backend=operations)
    plans: list[Plan | Barycentric] = [plan]
    if isinstance(plan, Plan):
        most = min(len(plan), SAMPLED_PAIRS)
        sizes = [most] if len(plan) == most == pairs else [max(1, most // 4), most]
        plans = [_thinned(plan, size) for size in sizes]
    found = [_time(source, target, thin, operations, detail, labels) for thin in plans]
    each, once = found[-1]
    if len(found) > 1 and len(plans[1]) > len(plans[0]):
        more = (pairs - len(plans[1])) / (len(plans[1]) - len(plans[0]))
        each += _growth(found[0][0], found[1][0], more, pairs / len(plans[1]))
        once += _growth(found[0][1], found[1][1], more, pairs / len(plans[1]))
    return n_frames * each + once


def fill_seconds(
    source: Measure, target: Measure, potentials: Potentials, pairs: int, operations: Operations
) -> float:
    """Estimate the time of writing a plan's counted pairs, in proportion to that of some rows."""
    whole = as_pair(source, target)
    count = max(1, round(SAMPLED_PAIRS * len(source) / max(1, pairs)))
    chosen, some, _ = sampled_part(whole[0], count, np.random.default_rng(0))
    rows, columns = uploaded(operations, some), RowsOfPlan(operations, whole, potentials).clouds[1]
    f, g, epsilon = potentials.f[chosen], potentials.g, potentials.epsilon
    thresholds = operations.row_maxima(rows, columns, g, epsilon) + f / epsilon
    thresholds += np.log(some.weights * 1e-4)
    none = np.full(len(g), np.inf)
    plan, precise = PlanTerms(rows, columns, f, g, epsilon, thresholds, none), potentials.precise
    counts = operations.count_plan_rows(plan, precise)
    began = perf_counter()
    operations.plan_rows(plan, precise, counts)
    return (perf_counter() - began) * pairs / max(1, int(counts.sum()))


def _growth(small: float, large: float, more: float, times: float) -> float:
    """Return the time to add to that of the larger sample, at most in proportion to its size."""
    return min(max(0.0, (large - small) * more), large * (times - 1.0))


def _time(
    source: Measure,
    target: Measure,
    plan: Plan | Barycentric,
    operations: Operations,
    detail: Detail,
    labels: Labels,
) -> tuple[float, float]:
    """Return the seconds of one frame, and those of the preparation before the first frame."""
    start, end = (auto_sigma(picture_of(measure)) for measure in (source, target))
    width = KernelWidth(start, end, 0.0, 1.0, 1.0, RenderOptions.splatting)

    def renderer(detail: str) -> FrameRenderer:
        moving = particles(source, target, plan, path_space=RenderOptions.path_space)
        moving = replace(moving, labels=labels)
        return FrameRenderer(
            source, target, plan, moving, width, operations, RenderOptions.endpoints,
            RenderOptions.unmatched, detail,
        )  # fmt: skip

    # Kernels are built first.
    renderer("particles").sums(0.5)
    if any(measure.alpha is not None for measure in (source, target)):
        renderer("particles").frame(0.5)
    began = perf_counter()
    made = renderer(detail)
    made.prepare()
    once = perf_counter() - began
    drawn = np.zeros(len(TIMES))
    for _ in range(PASSES):
        for number, t in enumerate(TIMES):
            began = perf_counter()
            made.frame(t)
            drawn[number] += (perf_counter() - began) / PASSES
    return float(drawn @ SHARES), once


def _thinned(plan: Plan, count: int) -> Plan:
    """Return a plan of at most `count` pairs, drawn by mass: light ones must not represent all."""
    if len(plan) <= count:
        return plan
    total = np.cumsum(plan.mass)
    strata = (np.arange(count) + np.random.default_rng(0).random(count)) * (total[-1] / count)
    drawn = np.minimum(np.searchsorted(total, strata, side="right"), len(plan) - 1)
    chosen, times = np.unique(drawn, return_counts=True)
    return Plan(
        np.searchsorted(chosen, plan.indptr),
        plan.indices[chosen],
        times * (total[-1] / count),
        plan.shape,
        *plan.marginals,
    )
