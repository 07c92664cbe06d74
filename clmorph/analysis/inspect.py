"""A look at the transport between two images: its numbers, before any frame is drawn."""

import time
from typing import Any

from numpy.typing import ArrayLike

from clmorph._shared.validation import check_flag, check_number, check_progress
from clmorph.analysis.report import Inspection, Seconds
from clmorph.analysis.timing import SAMPLED_PAIRS, fill_seconds, frame_seconds
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import PlanSizeError
from clmorph.images.pixels import as_pixels
from clmorph.measures.lift import Measure
from clmorph.measures.lift_pair import lift_pair
from clmorph.measures.points import as_pair
from clmorph.pipeline import presets as defaults
from clmorph.pipeline.budget import (
    check_ways,
    choose_way,
    finest_pixels,
    make_plan,
    warn_if_much_is_dropped,
)
from clmorph.pipeline.memory import estimate
from clmorph.pipeline.morph import StageProgress, check_options
from clmorph.transport.displacement import Displacement, displacement_of, displacement_statistics
from clmorph.transport.divergence import sinkhorn_divergence
from clmorph.transport.plan import Plan, transport_plan
from clmorph.transport.plan_sampling import MAX_DRAWS, Barycentric
from clmorph.transport.potentials import Potentials
from clmorph.transport.refine_plan import PixelCells, in_cells, refined
from clmorph.transport.regularization import Reach
from clmorph.transport.sinkhorn import sinkhorn

__all__ = ["Inspection", "Seconds", "inspect"]


def inspect(
    image_a: ArrayLike,
    image_b: ArrayLike,
    *,
    blur: float = defaults.BLUR,
    reach: Reach = defaults.REACH,
    color_weight: float = defaults.COLOR_WEIGHT,
    epsilon: float | None = None,
    rho: float | tuple[float, float] | None = None,
    tol: float = defaults.TOL,
    max_iter: int = defaults.MAX_ITER,
    extent: str = "true",
    mass: str = "uniform",
    color_space: str = "srgb",
    color_metric: ArrayLike | None = None,
    weights: tuple[ArrayLike | None, ArrayLike | None] | None = None,
    solve_size: int | None = None,
    max_particles: int | None = None,
    max_memory: float | None = None,
    log_threshold: float | None = None,
    n_frames: int = defaults.N_FRAMES,
    backend: Backend = "auto",
    divergence: bool = True,
    max_bytes: float = defaults.MAX_PLAN_BYTES,
    progress: StageProgress | None = None,
) -> Inspection:
    """Solve the transport between two images and measure it; draw no morph.

    Parameters
    ----------
    image_a, image_b, blur, reach, color_weight, epsilon, rho, tol, max_iter, extent, mass, \
color_space, color_metric, weights, backend
        As in `clmorph.morph`.
    solve_size, max_particles, max_memory, log_threshold
        As in `clmorph.morph`: the first and the last decide what is looked at, the others what a
        morph would draw.
    n_frames : int
        For how many frames time is estimated.
    divergence : bool
        Whether to compute the Sinkhorn divergence: two further, easier solves.
    max_bytes : float
        The most that the plan may take, see `clmorph.transport_plan`; a larger one is counted
        but not built.
    progress : callable, optional
        Called with a stage's name ("transport", "divergence", "plan", "timing") and the share
        of it done.

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
    options = check_options(
        n_frames, blur, reach, color_weight, epsilon=epsilon, rho=rho, tol=tol,
        max_iter=max_iter, extent=extent, mass=mass, color_space=color_space,
        solve_size=solve_size, max_particles=max_particles, max_memory=max_memory,
        log_threshold=log_threshold,
    )  # fmt: skip
    max_bytes = check_number("max_bytes", max_bytes, 1.0, 1e18)
    divergence = check_flag("divergence", divergence)
    report = check_progress(progress)
    n_frames, tol, max_iter, solve_size, max_particles, max_memory, log_threshold = (
        options[name] for name in (
            "n_frames", "tol", "max_iter", "solve_size", "max_particles", "max_memory",
            "log_threshold",
        )
    )  # fmt: skip
    images = as_pixels(image_a, "image_a"), as_pixels(image_b, "image_b")
    whole = lift_pair(
        images, color_weight, weights=weights, mass=mass, extent=extent,
        color_space=color_space, color_metric=color_metric,
    )  # fmt: skip
    coarsest = solve_size or max(whole[0].shape + whole[1].shape)
    cells = in_cells(whole[0], coarsest), in_cells(whole[1], coarsest)
    source, target = cells[0].coarse, cells[1].coarse
    operations = get_backend(backend)
    check_ways(*cells, operations, max_memory=max_memory, log_threshold=log_threshold)
    report("transport", 0.0)
    began = time.perf_counter()
    potentials = sinkhorn(
        source, target, blur, reach, tol, max_iter, operations, epsilon=epsilon, rho=rho,
        progress=lambda share: report("transport", share),
    )  # fmt: skip
    transport_seconds = time.perf_counter() - began

    found, why = None, _no_divergence(source, potentials, divergence)
    if not why:
        report("divergence", 0.0)
        found = sinkhorn_divergence(
            source, target, potentials.blur, _one(potentials.reach), tol, max_iter, operations,
            cross=potentials, progress=lambda share: report("divergence", share),
        )  # fmt: skip

    report("plan", 0.0)
    plan, pairs, plan_seconds = _plan(
        source, target, potentials, max_bytes, log_threshold, operations
    )
    if plan is not None and log_threshold is not None:
        warn_if_much_is_dropped(plan, log_threshold, stacklevel=2)
    if plan is None:
        moved = _streamed_displacement(source, target, potentials, operations)
        plan_seconds += fill_seconds(source, target, potentials, pairs, operations)
    else:
        moved = displacement_statistics(source, target, plan)
    report("plan", 1.0)

    report("timing", 0.0)
    way = choose_way(
        *cells, potentials, operations, max_particles, max_memory, log_threshold, stacklevel=2
    )
    drawn, moving = _drawn(cells, potentials, plan, pairs, way, operations)
    frames = frame_seconds(*whole, potentials, drawn, moving, n_frames, operations)
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
        memory=estimate(
            whole[0].shape, whole[1].shape, moving, backend=operations,
            alpha=any(measure.alpha is not None for measure in whole),
            barycentric=isinstance(drawn, Barycentric),
            dimension=as_pair(source, target)[0].points.shape[1],
        ),
        seconds=Seconds(transport_seconds, plan_seconds, frames),
        n_frames=n_frames,
        moving=moving,
        shapes=(whole[0].shape, whole[1].shape),
        device=operations.description,
    )  # fmt: skip


def _plan(
    source: Measure,
    target: Measure,
    potentials: Potentials,
    max_bytes: float,
    log_threshold: float | None,
    operations: Operations,
) -> tuple[Plan | None, int, float]:
    """Return the plan if it may be built, its number of pairs, and the seconds it took."""
    began = time.perf_counter()
    plan: Plan | None = None
    try:
        plan = transport_plan(
            source, target, potentials, log_threshold=log_threshold, max_bytes=max_bytes,
            backend=operations,
        )  # fmt: skip
        pairs = len(plan)
    except PlanSizeError as error:
        pairs = error.pairs
    return plan, pairs, time.perf_counter() - began


def _drawn(
    cells: tuple[PixelCells, PixelCells],
    potentials: Potentials,
    plan: Plan | None,
    pairs: int,
    way: dict[str, Any],
    operations: Operations,
) -> tuple[Plan | Barycentric | None, int]:
    """Return what a morph would draw, as far as it may be built, and how much would travel."""
    finest = finest_pixels(*cells)
    if way:
        made = make_plan(*cells, potentials, operations, **way)
        return made, len(made)
    if plan is not None:
        made = refined(plan, *cells)
        return made, len(made)
    if finest == 1:
        return None, pairs
    # A sample stands for the plan that may not be built: between pixels, as what is drawn.
    draws = max(1, min(MAX_DRAWS // finest, SAMPLED_PAIRS // len(cells[0].fine)))
    way = {"sample": draws} if finest <= MAX_DRAWS else {"barycentric": True}
    return make_plan(*cells, potentials, operations, **way), pairs * finest


def _no_divergence(source: Measure, potentials: Potentials, wanted: bool) -> str:
    """Why there is no divergence, empty if there is one."""
    if not wanted:
        return "not asked for"
    if isinstance(potentials.reach, tuple):
        return "reach differs between source and target"
    if source.has_metric_map:
        return "each source pixel has its own metric"
    return ""


def _one(reach: Reach) -> float | None:
    assert not isinstance(reach, tuple)  # as `_no_divergence` saw
    return reach


def _streamed_displacement(
    source: Measure, target: Measure, potentials: Potentials, operations: Operations
) -> Displacement:
    """Displacement by the whole plan, which is never built."""
    rows, columns = (
        operations.upload(measure.points, measure.weights, measure.offsets)
        for measure in as_pair(source, target)
    )
    g, epsilon, precise = potentials.g, potentials.epsilon, potentials.precise
    softmin = operations.softmin(rows, columns, g, epsilon, precise)
    mean, _ = operations.plan_moments(rows, columns, g, softmin, epsilon, precise)
    # Positions are the first two coordinates of lifted points, whatever the cost.
    return displacement_of(source, target, mean[:, :2], potentials.row_mass, potentials.column_mass)
