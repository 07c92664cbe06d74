"""The composition: two images in, a morph out."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clmorph._shared.validation import (
    as_float,
    check_choice,
    check_color_weight,
    check_flag,
    check_integer,
    check_number,
    check_progress,
    check_sigma,
    shown,
)
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.frames.endpoints import ENDPOINTS
from clmorph.frames.kernel_width import SPLATTING, KernelWidth, effective_count
from clmorph.frames.particles import UNMATCHED, particles
from clmorph.images.color import COLOR_SPACES
from clmorph.images.detail import auto_sigma
from clmorph.images.pixels import as_pixels
from clmorph.measures.lift import MASSES
from clmorph.measures.lift_pair import lift_pair
from clmorph.measures.measure import EXTENTS, Measure
from clmorph.measures.pixel_blocks import group_pixels
from clmorph.output.playback import EASES, eased
from clmorph.pipeline import presets as defaults
from clmorph.pipeline.budget import check_ways, make_plan
from clmorph.pipeline.optimal_width import NO_DIVERGENCE, optimal_curve
from clmorph.pipeline.result import Morph
from clmorph.transport.barycentric import Barycentric, destination_colors
from clmorph.transport.plan import Plan
from clmorph.transport.plan_sampling import MAX_DRAWS
from clmorph.transport.pruning import check_log_threshold
from clmorph.transport.regularization import Reach, regularization
from clmorph.transport.sinkhorn import check_solver_options, sinkhorn

#: Called with the name of a stage and the share of it that is done.
StageProgress = Callable[[str, float], None]
#: A kernel width in pixels, or "auto": by the image's own resolution.
Sigma = float | str


def check_options(
    n_frames: int = defaults.N_FRAMES,
    blur: float = defaults.BLUR,
    reach: Reach = defaults.REACH,
    color_weight: float = defaults.COLOR_WEIGHT,
    sigma_start: Sigma = defaults.SIGMA_START,
    sigma_end: Sigma = defaults.SIGMA_END,
    gamma: float = defaults.GAMMA,
    *,
    epsilon: float | None = None,
    rho: float | tuple[float, float] | None = None,
    tol: float = defaults.TOL,
    max_iter: int = defaults.MAX_ITER,
    extent: str = "true",
    splatting: str = "adaptive",
    sigma: str | None = None,
    endpoints: str = "exact",
    unmatched: str = "fade",
    mass: str = "uniform",
    color_space: str = "srgb",
    path_space: str = "srgb",
    barycentric: bool = False,
    sample: int | None = None,
    seed: int = 0,
    ease: str = "linear",
    solve_size: int | None = None,
    max_particles: int | None = None,
    max_memory: float | None = None,
    log_threshold: float | None = None,
) -> dict[str, Any]:
    """Check the options of `morph` without doing any of its work.

    Returns
    -------
    dict
        The same options, as plain numbers, texts and truth values; but `blur`, `reach`, `epsilon`
        and `rho` as they were given.

    Raises
    ------
    InputError
        If one cannot be used.
    """
    options: dict[str, Any] = dict(locals())
    options["n_frames"] = check_integer("n_frames", n_frames, 2, 100_000)
    given = regularization(blur, reach, epsilon, rho)
    options["color_weight"] = check_color_weight(color_weight)
    for name, width in (("sigma_start", sigma_start), ("sigma_end", sigma_end)):
        if not (isinstance(width, str) and width == "auto"):
            options[name] = check_sigma(name, width)
    options["gamma"] = check_number("gamma", gamma, 0.0, 1e4)
    options["tol"], options["max_iter"], _ = check_solver_options(tol, max_iter)
    check_choice("extent", extent, EXTENTS)
    check_choice("splatting", splatting, SPLATTING)
    if sigma is not None and (not _is_optimal(sigma) or splatting not in ("adaptive", "local")):
        raise InputError(
            f"sigma={shown(sigma)}: expected 'optimal' or nothing, and splatting 'adaptive' or "
            "'local' with it; widths in pixels are sigma_start and sigma_end"
        )
    if sigma is not None and isinstance(given.reach, tuple):
        raise InputError(NO_DIVERGENCE)
    check_choice("endpoints", endpoints, ENDPOINTS)
    check_choice("unmatched", unmatched, UNMATCHED)
    check_choice("mass", mass, MASSES)
    check_choice("color_space", color_space, COLOR_SPACES)
    check_choice("path_space", path_space, COLOR_SPACES)
    options["barycentric"] = check_flag("barycentric", barycentric)
    if sample is not None:
        options["sample"] = check_integer("sample", sample, 1, MAX_DRAWS)
        if barycentric:
            raise InputError(f"barycentric=True and sample={sample} contradict: give one of them")
    options["seed"] = check_integer("seed", seed, 0, 2**63)
    check_choice("ease", ease, EASES)
    if solve_size is not None:
        options["solve_size"] = check_integer("solve_size", solve_size, 2, 1 << 16)
    if max_particles is not None:
        options["max_particles"] = check_integer("max_particles", max_particles, 1, 1 << 31)
    if max_memory is not None:
        options["max_memory"] = check_number("max_memory", max_memory, 1.0, 1e18)
    if log_threshold is not None:
        options["log_threshold"] = tau = check_log_threshold(log_threshold)
        for name, other in (("sample", sample), ("barycentric", barycentric or None)):
            if other is not None:
                raise InputError(
                    f"log_threshold={tau:g} and {name}={other} contradict: draws and means are of "
                    "the whole plan; give one of them"
                )
    return options


def _is_optimal(sigma: Any) -> bool:
    return isinstance(sigma, str) and sigma == "optimal"


def morph(
    image_a: ArrayLike,
    image_b: ArrayLike,
    n_frames: int = defaults.N_FRAMES,
    blur: float = defaults.BLUR,
    reach: Reach = defaults.REACH,
    color_weight: float = defaults.COLOR_WEIGHT,
    sigma_start: Sigma = defaults.SIGMA_START,
    sigma_end: Sigma = defaults.SIGMA_END,
    gamma: float = defaults.GAMMA,
    backend: Backend = "auto",
    *,
    epsilon: float | None = None,
    rho: float | tuple[float, float] | None = None,
    tol: float = defaults.TOL,
    max_iter: int = defaults.MAX_ITER,
    extent: str = "true",
    splatting: str = "adaptive",
    sigma: str | None = None,
    endpoints: str = "exact",
    unmatched: str = "fade",
    mass: str = "uniform",
    weights: tuple[ArrayLike | None, ArrayLike | None] | None = None,
    color_space: str = "srgb",
    color_metric: ArrayLike | None = None,
    path_space: str = "srgb",
    barycentric: bool = False,
    sample: int | None = None,
    seed: int = 0,
    ease: str = "linear",
    solve_size: int | None = None,
    max_particles: int | None = None,
    max_memory: float | None = None,
    log_threshold: float | None = None,
    progress: StageProgress | None = None,
) -> Morph:
    """Morph one image into another by unbalanced optimal transport.

    Parameters
    ----------
    image_a, image_b : arrays
        See `clmorph.images.pixels.as_pixels`; of any sizes. The work grows with the product of
        their numbers of pixels: reduce photographs with `clmorph.fit`.
    n_frames : int
        At least 2; both ends are included.
    blur : float
        Entropic length scale, in image sides (epsilon = blur^2).
    reach : float, None, or a pair (reach_source, reach_target)
        Length scale beyond which mass fades rather than moves, in image sides
        (rho = reach^2); None is balanced.
    color_weight : float
        lambda, the weight of color against position.
    sigma_start, sigma_end, gamma : float
        Kernel width at both ends and its bulge between, in canvas pixels (Eq. 4). "auto" takes
        half the smallest detail of that image, see `clmorph.images.detail.auto_sigma`.
    backend : str or Operations
        See `clmorph.get_backend`.
    epsilon, rho, tol, max_iter
        See `clmorph.sinkhorn`; the first two in place of `blur` and `reach`.
    extent : {"true", "unit"}
        Keep the aspect ratio in the cost and the motion, or stretch both axes to [0, 1].
    splatting : {"adaptive", "local", "fixed", "none"}
        Kernel width of Eq. 4; a width for each particle, by the density around it and without
        `gamma`; `sigma_start` throughout; or each particle into its nearest pixel.
    sigma : "optimal", optional
        In place of Eq. 4 the widths whose frames are nearest to the particles themselves, see
        `clmorph.pipeline.optimal_width`; for "adaptive" and "local".
    endpoints : {"exact", "paper"}
        Bring the first and last frame to the images themselves, with a correction that travels
        and fades towards the middle; or leave them blurred by the kernel (Eq. 4 as printed).
    unmatched : {"fade", "drop"}
        Draw mass that does not travel as it dies and is born, or leave it out.
    mass : {"uniform", "luminance", "alpha"}
        What pixels weigh, see `clmorph.lift`; opacity always counts.
    weights : (map_a, map_b), optional
        Maps (H, W) of mass in its place, taken as they are; None stands for `mass`, with as
        much in all as the other's map.
    color_space : {"srgb", "linear", "lab", "luv", "oklab"}
        In which the cost compares colors.
    color_metric : (3, 3), (H, W, 3, 3) or (H, W) array, optional
        With which it does, see `clmorph.lift`; a map is of image_a's pixels.
    path_space : {"srgb", "linear", "lab", "luv", "oklab"}
        In which colors change evenly on the way, and are averaged.
    barycentric : bool
        One particle for each source pixel, to its mean destination, in place of one for each
        kept pair of the plan; for images whose plan is too large.
    sample : int, optional
        So many pairs a pixel drawn from the plan, in place of all kept ones: one from each column
        and the others, but at least one, from each row.
    seed : int
        Of these draws.
    ease : {"linear", "smooth", "in", "out"}
        How time runs over the frames, see `clmorph.output.playback.eased`.
    solve_size : int, optional
        Solve between square cells of pixels, at most so many along the longer side, and draw
        with the pixels themselves, which move as their cells do.
    max_particles : int, optional
        If the plan has more pairs, about so many are drawn from it, but at least one for each
        pixel of both images.
    max_memory : float, optional
        Bytes that it may take; by default half of the device's. If the plan's pairs would need
        more, draws from it or mean destinations take their place, with a warning.
    log_threshold : float, optional
        Keep the pairs of the plan with log pi_ij above this (the paper's tau = -13), in place of
        those above a share of the largest pair of their row or column. For small images: it drops
        everything from about 442000 pixels on, at a blur of 0.05 most from 96 x 96 on. Draws
        (`sample`, `max_particles`) and means are of the whole plan.
    progress : callable, optional
        Called with a stage's name and the share of it done.

    Returns
    -------
    Morph

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
        If the whole plan does not fit into `max_memory`.
    PruningWarning
        If `log_threshold` drops more than a quarter of the plan's mass.
    """
    options = check_options(
        n_frames, blur, reach, color_weight, sigma_start, sigma_end, gamma,
        epsilon=epsilon, rho=rho, tol=tol, max_iter=max_iter, extent=extent,
        splatting=splatting, sigma=sigma, endpoints=endpoints, unmatched=unmatched, mass=mass,
        color_space=color_space, path_space=path_space, barycentric=barycentric, sample=sample,
        seed=seed, ease=ease, solve_size=solve_size,
        max_particles=max_particles, max_memory=max_memory, log_threshold=log_threshold,
    )  # fmt: skip
    n_frames, tol, max_iter, solve_size = (
        options[name] for name in ("n_frames", "tol", "max_iter", "solve_size")
    )
    barycentric, sample, seed, max_particles, max_memory, log_threshold = (
        options[name] for name in (
            "barycentric", "sample", "seed", "max_particles", "max_memory", "log_threshold",
        )
    )  # fmt: skip
    report = check_progress(progress)
    images = as_pixels(image_a, "image_a"), as_pixels(image_b, "image_b")
    source, target = lift_pair(
        images, color_weight, weights=weights, mass=mass, extent=extent,
        color_space=color_space, color_metric=color_metric,
    )  # fmt: skip
    parameters = _told(options | {"weights": weights, "color_metric": color_metric})
    if sigma is not None and source.has_metric_map:
        raise InputError(NO_DIVERGENCE)
    if barycentric:
        destination_colors(source, target)  # can there be any?
    coarsest = solve_size or max(source.shape + target.shape)
    blocks = group_pixels(source, coarsest), group_pixels(target, coarsest)
    operations = get_backend(backend)
    check_ways(
        *blocks, operations, sample=sample, barycentric=barycentric, max_memory=max_memory,
        log_threshold=log_threshold,
    )  # fmt: skip
    report("transport", 0.0)
    potentials = sinkhorn(
        blocks[0].coarse, blocks[1].coarse, blur, reach, tol, max_iter, operations,
        epsilon=epsilon, rho=rho, progress=lambda share: report("transport", share),
    )  # fmt: skip
    report("plan", 0.0)
    plan = make_plan(
        *blocks, potentials, operations, sample=sample, barycentric=barycentric, seed=seed,
        max_particles=max_particles, max_memory=max_memory, log_threshold=log_threshold,
    )  # fmt: skip
    report("plan", 1.0)
    widths = options["sigma_start"], options["sigma_end"]
    ends = [
        auto_sigma(image) if width == "auto" else width
        for width, image in zip(widths, images, strict=True)
    ]
    result = Morph(
        source=source,
        target=target,
        potentials=potentials,
        plan=plan,
        particles=particles(source, target, plan, unmatched=unmatched, path_space=path_space),
        times=eased(np.linspace(0.0, 1.0, n_frames), ease),
        kernel_width=KernelWidth(
            ends[0], ends[1], options["gamma"],
            *_effective_counts(source, target, plan, unmatched), splatting,
        ),
        operations=operations,
        endpoints=endpoints,
        unmatched=unmatched,
        parameters=parameters,
    )  # fmt: skip
    if sigma is None:
        return result
    curve = optimal_curve(result, progress=lambda share: report("width", share))
    return replace(result, kernel_width=replace(result.kernel_width, curve=curve))


def _told(options: dict[str, Any]) -> dict[str, Any]:
    """Return checked options of `morph` as JSON takes them; of arrays that there were some."""
    told: dict[str, Any] = {}
    for name, value in options.items():
        told[name] = value
        if name in ("weights", "color_metric") and value is not None:
            parts = value if name == "weights" else (value,)
            told[name] = [None if part is None else "an array" for part in parts]
        elif name in ("reach", "rho") and value is not None:
            halves = as_float(value) is None
            told[name] = [_finite(part) for part in value] if halves else _finite(value)
        elif name in ("blur", "epsilon"):
            told[name] = _finite(value)
    return told


def _finite(strength: Any) -> float | None:
    """Return a strength as a number, None for balanced."""
    number = as_float(strength)
    return None if number is None or np.isinf(number) else number


def _effective_counts(
    source: Measure, target: Measure, plan: Plan | Barycentric, unmatched: str
) -> tuple[float, float]:
    """N_eff at both ends (Eq. 3), of what is drawn there: with "drop" the plan's marginals."""
    if unmatched == "fade":
        return effective_count(source.weights), effective_count(target.weights)
    row_mass, column_mass = plan.marginals
    return effective_count(row_mass), effective_count(column_mass)
