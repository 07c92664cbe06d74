"""The composition: two images in, a morph out."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph import defaults
from clmorph.backends import Backend, get_backend
from clmorph.checks import (
    check_choice,
    check_color_weight,
    check_integer,
    check_number,
    check_sigma,
)
from clmorph.errors import InputError
from clmorph.interpolation import UNMATCHED, Particles, particles
from clmorph.measures import EXTENTS, Measure, lift
from clmorph.operations import Operations
from clmorph.plan import Plan, transport_plan
from clmorph.potentials import Potentials
from clmorph.rendering import SPLATTING, Canvas, KernelWidth, canvas_at, effective_count, render
from clmorph.sampling import MAX_DRAWS, Barycentric, barycentric_plan, sample_plan
from clmorph.sinkhorn import check_solver_options, sinkhorn
from clmorph.strengths import Reach, strengths

#: Called with the name of a stage and the share of it that is done.
StageProgress = Callable[[str, float], None]


@dataclass(frozen=True, repr=False)
class Morph:
    """A morph between two images; frames are rendered when asked for.

    Attributes
    ----------
    source, target : Measure
    potentials : Potentials
    plan : Plan or Barycentric
    particles : Particles
    times : (n_frames,) array
        From 0 to 1.
    kernel_width : KernelWidth
    operations : Operations
        What renders the frames.
    """

    source: Measure
    target: Measure
    potentials: Potentials
    plan: Plan | Barycentric
    particles: Particles
    times: NDArray[np.float64]
    kernel_width: KernelWidth
    operations: Operations = field(repr=False)

    def __repr__(self) -> str:
        (h, w), (height, width) = self.source.shape, self.target.shape
        return (
            f"<Morph of {w} x {h} into {width} x {height} pixels, {len(self.times)} frames, "
            f"{len(self.particles)} particles, {self.potentials.message}>"
        )

    @cached_property
    def _uploaded(self) -> Any:
        moving = self.particles
        return self.operations.upload_particles(moving.table, moving.links, moving.weights)

    def canvas(self, t: float) -> Canvas:
        """Return the canvas at time t."""
        return canvas_at(t, self.source.shape, self.target.shape, self.source.extent)

    @cached_property
    def sigma(self) -> NDArray[np.float64]:
        """(n_frames,) kernel width at `times`, in pixels; 0 where there is no kernel."""
        return np.array([self.kernel_width.at(t, self.canvas(t)) for t in self.times])

    def frame(self, t: float) -> NDArray[np.float32]:
        """Render the frame at time t.

        Parameters
        ----------
        t : float in [0, 1]

        Returns
        -------
        (H(t), W(t), 3) float32 array
            sRGB in [0, 1].
        """
        return self._render(t)[0]

    def coverage(self, t: float) -> NDArray[np.float32]:
        """Return how well the particles cover each pixel at time t, before filling.

        Returns
        -------
        (H(t), W(t)) float32 array
            Kernel mass as a share of what an even spread would give; under
            `clmorph.rendering.HOLE_COVERAGE` a pixel is a hole.
        """
        return self._render(t)[1]

    def _render(self, t: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        t = check_number("t", t, 0.0, 1.0)
        canvas = self.canvas(t)
        sigma = self.kernel_width.at(t, canvas)
        return render(self.operations, self._uploaded, self.particles.mass(t), t, canvas, sigma)

    def iter_frames(self) -> Iterator[NDArray[np.float32]]:
        """Render the frames one by one, without keeping them."""
        return (self.frame(t) for t in self.times)

    @cached_property
    def frames(self) -> list[NDArray[np.float32]]:
        """All frames, at `times`; rendered at the first access, then kept."""
        return list(self.iter_frames())

    def save(self, path: str | PathLike[str]) -> None:
        """Write the morph to a file chosen by its ending, see `clmorph.export.save`.

        Raises
        ------
        OutputError
            If it cannot be written there.
        """
        from clmorph.export import save

        save(self.frames, self.times, path)


def check_options(
    n_frames: int = defaults.N_FRAMES,
    blur: float = defaults.BLUR,
    reach: Reach = defaults.REACH,
    color_weight: float = defaults.COLOR_WEIGHT,
    sigma_start: float = defaults.SIGMA_START,
    sigma_end: float = defaults.SIGMA_END,
    gamma: float = defaults.GAMMA,
    *,
    epsilon: float | None = None,
    rho: float | tuple[float, float] | None = None,
    tol: float = defaults.TOL,
    max_iter: int = defaults.MAX_ITER,
    extent: str = "true",
    splatting: str = "adaptive",
    unmatched: str = "fade",
    barycentric: bool = False,
    sample: int | None = None,
    seed: int = 0,
) -> None:
    """Check the options of `morph` without doing any of its work.

    Raises
    ------
    InputError
        If one cannot be used.
    """
    check_integer("n_frames", n_frames, 2, 100_000)
    strengths(blur, reach, epsilon, rho)
    check_color_weight(color_weight)
    check_sigma("sigma_start", sigma_start)
    check_sigma("sigma_end", sigma_end)
    check_number("gamma", gamma, 0.0, 1e4)
    check_solver_options(tol, max_iter)
    check_choice("extent", extent, EXTENTS)
    check_choice("splatting", splatting, SPLATTING)
    check_choice("unmatched", unmatched, UNMATCHED)
    if sample is not None:
        check_integer("sample", sample, 1, MAX_DRAWS)
        if barycentric:
            raise InputError(f"barycentric=True and sample={sample} contradict: give one of them")
    check_integer("seed", seed, 0, 2**63)


def morph(
    image_a: ArrayLike,
    image_b: ArrayLike,
    n_frames: int = defaults.N_FRAMES,
    blur: float = defaults.BLUR,
    reach: Reach = defaults.REACH,
    color_weight: float = defaults.COLOR_WEIGHT,
    sigma_start: float = defaults.SIGMA_START,
    sigma_end: float = defaults.SIGMA_END,
    gamma: float = defaults.GAMMA,
    backend: Backend = "auto",
    *,
    epsilon: float | None = None,
    rho: float | tuple[float, float] | None = None,
    tol: float = defaults.TOL,
    max_iter: int = defaults.MAX_ITER,
    extent: str = "true",
    splatting: str = "adaptive",
    unmatched: str = "fade",
    barycentric: bool = False,
    sample: int | None = None,
    seed: int = 0,
    progress: StageProgress | None = None,
) -> Morph:
    """Morph one image into another by unbalanced optimal transport.

    Parameters
    ----------
    image_a, image_b : arrays
        See `clmorph.images.as_rgb`; of any sizes. The work grows with the product of
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
        Kernel width at both ends and its bulge between, in canvas pixels (Eq. 4).
    backend : str or Operations
        See `clmorph.get_backend`.
    epsilon, rho, tol, max_iter
        See `clmorph.sinkhorn`; the first two in place of `blur` and `reach`.
    extent : {"true", "unit"}
        Keep the aspect ratio in the cost and the motion, or stretch both axes to [0, 1].
    splatting : {"adaptive", "fixed", "none"}
        Kernel width of Eq. 4; `sigma_start` throughout; or each particle into its
        nearest pixel.
    unmatched : {"fade", "drop"}
        Draw mass that does not travel as it dies and is born, or leave it out.
    barycentric : bool
        One particle for each source pixel, to its mean destination, in place of one for each
        kept pair of the plan; for images whose plan is too large.
    sample : int, optional
        So many pairs drawn from each row of the plan, in place of all kept ones.
    seed : int
        Of these draws.
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
    """
    check_options(
        n_frames, blur, reach, color_weight, sigma_start, sigma_end, gamma,
        epsilon=epsilon, rho=rho, tol=tol, max_iter=max_iter, extent=extent,
        splatting=splatting, unmatched=unmatched, barycentric=barycentric, sample=sample,
        seed=seed,
    )  # fmt: skip
    report = progress or (lambda stage, share: None)
    operations = get_backend(backend)

    source = lift(image_a, color_weight, extent=extent)
    target = lift(image_b, color_weight, extent=extent)
    report("transport", 0.0)
    potentials = sinkhorn(
        source, target, blur, reach, tol, max_iter, operations, epsilon=epsilon, rho=rho,
        progress=lambda share: report("transport", share),
    )  # fmt: skip
    report("plan", 0.0)
    plan: Plan | Barycentric
    if barycentric:
        plan = barycentric_plan(source, target, potentials, backend=operations)
    elif sample is not None:
        plan = sample_plan(source, target, potentials, sample, seed=seed, backend=operations)
    else:
        plan = transport_plan(source, target, potentials, backend=operations)
    report("plan", 1.0)
    moves = bool(plan.row_mass.any())
    return Morph(
        source=source,
        target=target,
        potentials=potentials,
        plan=plan,
        particles=particles(source, target, plan, unmatched=unmatched),
        times=np.linspace(0.0, 1.0, int(n_frames)),
        kernel_width=KernelWidth(
            float(sigma_start), float(sigma_end), float(gamma),
            effective_count(plan.row_mass if moves else source.weights),
            effective_count(plan.column_mass if moves else target.weights), splatting,
        ),
        operations=operations,
    )  # fmt: skip
