"""Rearrange the pixels of one image so that they form another one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Unpack

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.progress import StageProgress
from clmorph._shared.typing import AnyArray, Array, ArrayLike, Progress
from clmorph._shared.validation import check_number, check_progress
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.frames.cells import mirrored, owners_at
from clmorph.frames.frame_renderer import FrameRenderer
from clmorph.frames.kernel_width import KernelWidth
from clmorph.frames.particles import Particles, particles
from clmorph.images.detail import is_pixel_art
from clmorph.images.pixels import fit, split_alpha
from clmorph.images.resizing import as_unit, resized
from clmorph.measures.lift import lift
from clmorph.measures.measure import Measure
from clmorph.measures.options import LiftOptions
from clmorph.measures.pixel_blocks import PixelBlocks, group_pixels
from clmorph.output.playback import eased
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.film import Film, picture_of
from clmorph.pipeline.keywords import RearrangeKeywords
from clmorph.pipeline.prepare import as_images
from clmorph.pipeline.rearrange_options import RearrangeOptions
from clmorph.pipeline.recipe import recipe
from clmorph.transport._solver.softmin import Softmin
from clmorph.transport.assignment_search import solved
from clmorph.transport.matching import warn_unless_reached
from clmorph.transport.pair_costs import Costs, Indices
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import Goal, regularization
from clmorph.transport.sinkhorn import solve

#: Length scale of the entropic plan from which the search begins, and its tolerance.
BLUR, TOLERANCE = 0.025, 0.5
#: Above this color weight costs grow by its square, and so does epsilon; they would overflow.
LARGE_WEIGHT = 4.0
#: Largest number of blocks along the longer side between which that plan is solved.
SOLVE_SIZE = 256
#: Kernel width of `Rearrangement.sums`, in pixels.
SIGMA = 0.5


@dataclass(frozen=True, repr=False, eq=False)
class Rearrangement(Film):
    """The pixels of image A on their way to form image B: a sequence of frames, drawn on demand.

    ``len(found)`` is the number of frames and ``found[i]`` is the frame at ``times[i]``.

    Attributes
    ----------
    assignment : (H * W,) array of int
        The place at which each pixel of A arrives; pixels are counted row by row. A permutation.
    cost : float
        Mean over the pixels of half the squared distance between a pixel of A and the pixel of B
        whose place it takes, in position and color (`clmorph.lift`); in squared sides of the image.
    lower_bound : float
        No permutation has a lower cost.
    source, target : Measure
        Image A, and the picture that its pixels form in the end.
    potentials : Potentials
        Entropic potentials of the pixels, from which the search began.
    plan : Plan
        The permutation as a plan.
    particles : Particles
        One for each pixel.
    times : (n_frames,) array
        The times of the frames, ascending from 0 to 1.
    options : RearrangeOptions

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> a = np.array([[0.0, 0.25, 0.75, 1.0]])
    >>> found = clmorph.rearrange(a, a[:, ::-1], n_frames=3, color_weight=10.0, backend="numpy")
    >>> found.assignment.tolist()
    [3, 2, 1, 0]
    >>> found[-1][0, :, 0].tolist()
    [1.0, 0.75, 0.25, 0.0]
    """

    kind: ClassVar[str] = "Rearrangement"

    assignment: Indices
    cost: float
    lower_bound: float
    source: Measure
    target: Measure
    potentials: Potentials
    plan: Plan
    particles: Particles
    times: Array
    kernel_width: KernelWidth
    operations: Operations = field(repr=False)
    options: RearrangeOptions = field(repr=False)
    endpoints: str = "exact"
    unmatched: str = "drop"

    def __repr__(self) -> str:
        height, width = self.source.shape
        return (
            f"<Rearrangement of {width} x {height} pixels, {len(self)} frames, cost "
            f"{self.cost:.4g}, at least {self.lower_bound:.4g}>"
        )

    @property
    def parameters(self) -> dict[str, Any]:
        """The recipe in the form of files, which `json.dumps` accepts."""
        return recipe(self.options, device=self.operations.description)

    @property
    def detail(self) -> str:
        """What draws the frames: "pixels"."""
        return "pixels"

    @property
    def pixelated(self) -> bool:
        """Whether image A is pixel art."""
        return is_pixel_art(self._pixels.astype(float))

    def frame(self, t: float) -> NDArray[np.float32]:
        """Draw the pixels at time t of their straight ways: each place shows the nearest one.

        The first and the last frame hold each pixel once. Between them pixels that meet hide one
        another. Where they are far apart each one takes the room around it, and fills it with what
        is around it in A.

        Parameters
        ----------
        t : float in [0, 1]

        Returns
        -------
        (H, W, 3) float32 array
            sRGB in [0, 1]; (H, W, 4), with opacity, if A or B has transparent pixels.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> a = np.array([[0.0, 0.25, 0.75, 1.0]])
        >>> clmorph.rearrange(a, a, backend="numpy").frame(0.5)[0, :, 0].tolist()
        [0.0, 0.25, 0.75, 1.0]
        """
        t = check_number("t", t, 0.0, 1.0)
        positions, shape = self.source.positions, self.source.shape
        ends = positions[self.assignment]
        nearest = owners_at(positions, ends, t, self.canvas(t), self.operations)
        ways = np.stack(np.unravel_index(self.assignment, shape)) - np.indices(shape).reshape(2, -1)
        # Halves are rounded alike, so that neighbors stay neighbors.
        places = np.floor(np.indices(shape) - t * ways[:, nearest] + 0.5).astype(np.intp)
        return self._pixels[tuple(mirrored(places, shape))]

    @cached_property
    def _pixels(self) -> NDArray[np.float32]:
        return picture_of(self.source).astype(np.float32)

    @cached_property
    def _renderer(self) -> FrameRenderer:
        return FrameRenderer(
            self.source, self.target, self.plan, self.particles, self.kernel_width,
            self.operations, self.endpoints, self.unmatched, "particles",
        )  # fmt: skip


@documented(RearrangeOptions)
def rearrange(
    image_a: ArrayLike,
    image_b: ArrayLike,
    options: RearrangeOptions | None = None,
    *,
    backend: Backend = "auto",
    progress: StageProgress | None = None,
    **given: Unpack[RearrangeKeywords],
) -> Rearrangement:
    """Move the pixels of image A, each with its own color, so that they form image B.

    The permutation is the cheapest one, but for a share `gap` of the cost, which is proven.

    Parameters
    ----------
    image_a, image_b : arrays
        See `clmorph.images.pixels.as_pixels`. A is reduced to `size`, and B is resized to the
        height and width of A. Opacity is compared as a further channel, and colors are multiplied
        by it.
    options : RearrangeOptions, optional
        All options at once; options given by name replace those of this object.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.
    progress : callable, optional
        A function that is called with a stage's name and the share of it that is done.
    {options}

    Returns
    -------
    Rearrangement

    Raises
    ------
    InputError
        If an argument cannot be used.
    DeviceError
        If the device cannot be found or fails.

    Warns
    -----
    ConvergenceWarning
        If the gap is not reached; the bound is proven in any case.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> a = np.array([[0.0, 0.25, 0.75, 1.0]])
    >>> found = clmorph.rearrange(a, a[:, ::-1], n_frames=3, color_weight=10.0, backend="numpy")
    >>> found.assignment.tolist()
    [3, 2, 1, 0]
    >>> found.lower_bound <= found.cost <= 1.01 * found.lower_bound
    True
    """
    chosen = RearrangeOptions.of_call(options, given, "n_frames=30")
    images = as_images((image_a, image_b))
    return arranged(images, chosen, backend, check_progress(progress))


def arranged(
    images: Sequence[AnyArray], options: RearrangeOptions, backend: Backend, report: StageProgress
) -> Rearrangement:
    """Rearrange image A to form B; the parameters are checked ones of `rearrange`."""
    first = as_unit(images[0]) if options.size is None else fit(images[0], options.size)
    shape = first.shape[:2]
    second = np.clip(resized(images[1], (shape[0], shape[1])), 0.0, 1.0)
    source, target = _compared((first, second), options)
    operations = get_backend(backend)
    report("transport", 0.0)
    blocks = group_pixels(source, SOLVE_SIZE), group_pixels(target, SOLVE_SIZE)
    goal = regularization(BLUR * max(1.0, options.color_weight / LARGE_WEIGHT), tol=TOLERANCE)
    potentials = _potentials(*blocks, goal, operations, lambda share: report("transport", share))
    costs, epsilon = Costs(source.points, target.points), potentials.epsilon
    solution = solved(
        costs, potentials.g, epsilon, options.gap, options.seed,
        lambda share: report("pixels", share), operations=operations,
    )  # fmt: skip
    warn_unless_reached(solution, options.gap)
    assignment, n_pixels = solution.columns, len(source)
    cost, bound = solution.cost / n_pixels, solution.bound / n_pixels
    # Frames are float32, so that the last one is exact; cost and bound are those of what was given.
    begin, plan = _measure(first.astype(np.float32).astype(float), options), _as_plan(assignment)
    end = _moved(begin, assignment)
    n = float(len(assignment))
    return Rearrangement(
        assignment, cost, bound, begin, end, potentials, plan,
        particles(begin, end, plan, unmatched="drop"),
        eased(np.linspace(0.0, 1.0, options.n_frames), options.ease),
        KernelWidth(SIGMA, SIGMA, 0.0, n, n, "fixed"), operations, options,
    )  # fmt: skip


def _potentials(
    source: PixelBlocks, target: PixelBlocks, goal: Goal, operations: Operations, report: Progress
) -> Potentials:
    """Solve between blocks, and extend the potentials to the pixels by one softmin each."""
    found = solve(operations, (source.coarse, target.coarse), goal, report)

    def extended(own: PixelBlocks, other: PixelBlocks, f: Array, g: Array) -> Array:
        rows, columns = (operations.upload(m.points, m.weights) for m in (own.fine, other.coarse))
        weights = own.fine.weights, other.coarse.weights
        softmin = Softmin(operations, rows, columns, weights, found.truncation)
        softmin.guess = f[own.owners]
        return softmin(g, found.epsilon)

    f, g = extended(source, target, found.f, found.g), extended(target, source, found.g, found.f)
    return replace(found, f=f, g=g)


def _compared(images: tuple[Array, Array], options: RearrangeOptions) -> tuple[Measure, Measure]:
    """Return the images as measures of equal masses for the cost."""
    colors, opacity = zip(*map(split_alpha, images), strict=True)
    if all(alpha is None for alpha in opacity):
        first, second = (lift(image, **options.of(LiftOptions)) for image in colors)
        return first, second
    found = []
    for image, alpha in zip(colors, opacity, strict=True):
        alpha = np.ones(image.shape[:2]) if alpha is None else alpha
        measure = lift(image * alpha[..., None], **options.of(LiftOptions))
        found.append(replace(measure, features=options.color_weight * alpha.reshape(-1, 1)))
    return found[0], found[1]


def _measure(image: Array, options: RearrangeOptions) -> Measure:
    """Return an image as a measure whose pixels have equal masses, whatever their opacity."""
    colors, alpha = split_alpha(image)
    measure = lift(colors, **options.of(LiftOptions))
    return measure if alpha is None else replace(measure, alpha=alpha.ravel())


def _moved(measure: Measure, assignment: Indices) -> Measure:
    """Return the picture that the pixels form where they arrive."""
    pixel = np.empty_like(assignment)
    pixel[assignment] = np.arange(len(assignment))
    alpha = None if measure.alpha is None else measure.alpha[pixel]
    return replace(measure, colors=measure.colors[pixel], alpha=alpha)


def _as_plan(assignment: Indices) -> Plan:
    """Return a permutation as a transport plan."""
    n = len(assignment)
    masses = np.full(n, 1.0 / n)
    targets = assignment.astype(np.int32)
    return Plan(np.arange(n + 1), targets, masses, (n, n), masses, masses)
