"""Inspect the transport between two images: measure it without drawing a frame."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike

from clmorph._shared.options import specifications
from clmorph._shared.progress import StageProgress
from clmorph._shared.validation import check_flag, check_progress
from clmorph.analysis.inspection import Inspection
from clmorph.analysis.report import Marks, Seconds
from clmorph.analysis.timing import SAMPLED_PAIRS, fill_seconds, frame_seconds
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import PlanSizeError
from clmorph.measures.landmark_options import GuideOptions
from clmorph.measures.measure import Measure
from clmorph.measures.options import LiftOptions
from clmorph.measures.points import as_pair
from clmorph.pipeline.budget import (
    check_ways,
    choose_way,
    finest_pixels,
    make_plan,
    pruned,
    warn_if_much_is_dropped,
)
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.keywords import MorphKeywords
from clmorph.pipeline.maps import Maps
from clmorph.pipeline.memory import expected, process_memory
from clmorph.pipeline.morph import ImagePair
from clmorph.pipeline.options import BudgetOptions, MorphOptions
from clmorph.pipeline.prepare import as_images, as_options
from clmorph.pipeline.presets import PresetName
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.displacement import Displacement, displacement_of, displacement_statistics
from clmorph.transport.divergence import sinkhorn_divergence
from clmorph.transport.options import MAX_DRAWS, PruningOptions, SolverOptions
from clmorph.transport.plan import BYTES_PER_PAIR, Plan
from clmorph.transport.plan_building import transport_plan
from clmorph.transport.potentials import Potentials
from clmorph.transport.refine_plan import refined
from clmorph.transport.subproblems import Subproblem, joined

__all__ = ["inspect"]

#: The options that affect the transport, and the time and memory of a morph by it.
INSPECTED = (
    *specifications(LiftOptions), *specifications(GuideOptions), *specifications(BudgetOptions),
    *specifications(SolverOptions), "log_threshold", "n_frames",
)  # fmt: skip


@documented(MorphOptions, INSPECTED)
def inspect(
    image_a: ArrayLike,
    image_b: ArrayLike,
    options: MorphOptions | None = None,
    *,
    preset: PresetName | None = None,
    backend: Backend = "auto",
    weights: tuple[ArrayLike | None, ArrayLike | None] | None = None,
    color_metric: ArrayLike | None = None,
    labels: tuple[ArrayLike, ArrayLike] | Literal["auto"] | None = None,
    features: tuple[ArrayLike, ArrayLike] | None = None,
    divergence: bool = True,
    max_bytes: float = PruningOptions.max_bytes,
    progress: StageProgress | None = None,
    **given: Unpack[MorphKeywords],
) -> Inspection:
    """Solve the transport between two images and measure it, without drawing a morph.

    Parameters
    ----------
    image_a, image_b, options, preset, backend, weights, color_metric, labels, features
        As in `clmorph.morph`.
    divergence : bool
        Whether to compute the Sinkhorn divergence: two further, easier solves. With labels there
        is none.
    max_bytes : float
        The limit of the plan's memory in bytes, see `clmorph.transport_plan`. The pairs of a
        larger plan are counted, but the plan is not built.
    progress : callable, optional
        Called with a stage's name ("transport", "divergence", "plan", "timing") and the share
        of it done.
    {options}

    Returns
    -------
    Inspection

    Raises
    ------
    InputError
        If an argument cannot be used.
    DeviceError
        If the device cannot be found or fails.

    Warns
    -----
    ConvergenceWarning
        If the solver stops before `tol`.
    MemoryWarning
        If the particles of a morph would not all fit into `max_memory`.
    PruningWarning
        If `log_threshold` drops more than a quarter of the plan's mass.

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> found = clmorph.inspect(left, right, blur=0.1, reach=0.3, backend="numpy")
    >>> round(found.transported + found.destroyed, 2)
    1.0
    >>> found.divergence.value > 0
    True
    """
    images = as_images((image_a, image_b))
    # All pairs are counted, however a morph would draw.
    chosen = as_options(options, preset, given, images).replace(sample=None, barycentric=False)
    max_bytes = PruningOptions.checked("max_bytes", max_bytes)
    divergence = check_flag("divergence", divergence)
    report = check_progress(progress)
    pair = ImagePair.of(images, chosen, Maps(weights, color_metric, labels, features))
    source, target, misses = pair.measures()
    landmarks: Any = pair.options.landmarks or ()
    whole = source, target
    blocks, parts = pair.parts(*whole)
    source, target = blocks[0].coarse, blocks[1].coarse
    log_threshold, n_frames = chosen.log_threshold, chosen.n_frames
    operations = get_backend(backend)
    process = process_memory(operations)
    check_ways(*blocks, operations, chosen)
    report("transport", 0.0)
    began = time.perf_counter()
    solved, potentials = pair.solve(
        parts, (source.mass, target.mass), operations, lambda share: report("transport", share)
    )
    transport_seconds = time.perf_counter() - began

    found, why = None, _no_divergence(source, potentials, divergence, pair.maps)
    if not why:
        report("divergence", 0.0)
        assert not isinstance(potentials.reach, tuple)
        found = sinkhorn_divergence(
            source, target, potentials.blur, potentials.reach, chosen.tol, chosen.max_iter,
            operations,
            cross=potentials, progress=lambda share: report("divergence", share),
        )  # fmt: skip

    report("plan", 0.0)
    plan, pairs_of, plan_seconds = _plan(parts, solved, max_bytes, log_threshold, operations)
    pairs = sum(pairs_of)
    if plan is not None and log_threshold is not None:
        warn_if_much_is_dropped(plan, log_threshold, stacklevel=2)
    if plan is None:
        moved = _streamed_displacement(source, target, parts, solved, operations)
        for part, each, count in zip(parts, solved, pairs_of, strict=True):
            plan_seconds += fill_seconds(*part.measures, each, count, operations)
    else:
        moved = displacement_statistics(source, target, plan)
    report("plan", 1.0)

    report("timing", 0.0)
    way = choose_way(parts, solved, operations, chosen, stacklevel=2)
    drawn, moving = _drawn(parts, solved, plan, pairs, way, log_threshold, operations)
    frames = frame_seconds(
        *whole, potentials, drawn, moving, n_frames, operations, chosen.detail, pair.labels(*whole)
    )
    report("timing", 1.0)
    return Inspection(
        source=source,
        target=target,
        potentials=potentials,
        plan=plan,
        pairs=pairs,
        displacement=moved,
        divergence=found,
        no_divergence=why,
        memory=expected(
            [(*image.shape[:2], image.shape[2]) for image in pair.images], pair.options,
            operations, pair.maps, process=process, particles=moving,
        ),
        seconds=Seconds(transport_seconds, plan_seconds, frames),
        n_frames=n_frames,
        moving=moving,
        shapes=(whole[0].shape, whole[1].shape),
        device=operations.description,
        marks=Marks(landmarks, pair.given_shapes, misses, pair.found),
    )  # fmt: skip


def _plan(
    parts: Sequence[Subproblem],
    solved: Sequence[Potentials],
    max_bytes: float,
    log_threshold: float | None,
    operations: Operations,
) -> tuple[Plan | None, list[int], float]:
    """Return the plan (None above `max_bytes`), its pairs in each part, and its seconds."""
    began = time.perf_counter()
    plans: list[Plan] = []
    pairs: list[int] = []
    for part, potentials in zip(parts, solved, strict=True):
        try:
            left = max(1.0, max_bytes - BYTES_PER_PAIR * sum(pairs))
            plan = transport_plan(
                *part.measures, potentials, log_threshold=log_threshold, max_bytes=left,
                backend=operations,
            )  # fmt: skip
            plans.append(part.between_blocks(plan))
            pairs.append(len(plan))
        except PlanSizeError as error:
            pairs.append(error.pairs)
    seconds = time.perf_counter() - began
    if len(plans) < len(parts):
        return None, pairs, seconds
    whole = joined(parts, plans)
    assert isinstance(whole, Plan)
    return whole, pairs, seconds


def _drawn(
    parts: Sequence[Subproblem],
    solved: Sequence[Potentials],
    plan: Plan | None,
    pairs: int,
    way: dict[str, Any],
    log_threshold: float | None,
    operations: Operations,
) -> tuple[Plan | Barycentric | None, int]:
    """Return the plan that a morph would draw, if it may be built, and its number of pairs."""
    blocks = parts[0].blocks
    finest = finest_pixels(*blocks)
    if way:
        made = make_plan(parts, solved, operations, MorphOptions(**way))
        return made, len(made)
    if plan is not None:
        if parts[0].points is None or finest == 1:
            made = refined(plan, *blocks)
        else:
            each = zip(parts, solved, strict=True)
            made = joined(parts, [pruned(*one, operations, log_threshold) for one in each])
        return made, len(made)
    if finest == 1 and parts[0].points is None:
        return None, pairs
    # A sample takes the place of a plan that may not be built: pairs of pixels, as a morph draws.
    draws = max(1, min(MAX_DRAWS // finest, SAMPLED_PAIRS // len(blocks[0].fine)))
    way = {"sample": draws} if finest <= MAX_DRAWS else {"barycentric": True}
    return make_plan(parts, solved, operations, MorphOptions(**way)), pairs * finest


def _no_divergence(source: Measure, potentials: Potentials, wanted: bool, maps: Maps) -> str:
    """Return the reason why there is no divergence; empty if there is one."""
    if not wanted:
        return "not asked for"
    if maps.labels is not None:
        return "labels keep parts of the images apart"
    if isinstance(potentials.reach, tuple):
        return "reach differs between source and target"
    if source.has_metric_map:
        return "each source pixel has its own metric"
    return ""


def _streamed_displacement(
    source: Measure,
    target: Measure,
    parts: Sequence[Subproblem],
    solved: Sequence[Potentials],
    operations: Operations,
) -> Displacement:
    """Return the displacement by the whole plan, without building it."""
    moments = np.zeros((len(source), 2))
    rows, columns = np.zeros(len(source)), np.zeros(len(target))
    for part, potentials in zip(parts, solved, strict=True):
        points = part.points or (np.arange(len(source)), np.arange(len(target)))
        clouds = [
            operations.upload(measure.points, measure.weights, measure.offsets)
            for measure in as_pair(*part.measures)
        ]
        g, epsilon, precise = potentials.g, potentials.epsilon, potentials.precise
        _, mean = operations.barycentric_projection(clouds[0], clouds[1], g, epsilon, precise)
        # Positions are the first two coordinates of lifted points, whatever the cost.
        moments[points[0]] += mean[:, :2] * potentials.row_mass[:, None]
        rows[points[0]] += potentials.row_mass
        columns[points[1]] += potentials.column_mass
    ends = source.positions.copy()
    np.divide(moments, rows[:, None], out=ends, where=rows[:, None] > 0)
    return displacement_of(source, target, ends, rows, columns)
