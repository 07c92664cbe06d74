"""Compose the stages: compute a morph from two images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph._shared.progress import StageProgress
from clmorph._shared.typing import AnyArray, IntArray, Progress
from clmorph._shared.validation import check_progress
from clmorph.backends.interface import Operations
from clmorph.backends.multi_device import members_of
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.frames.as_measure import frame_measure, particle_measure
from clmorph.frames.kernel_width import KernelWidth, effective_count
from clmorph.frames.particles import particles
from clmorph.frames.render import Widths
from clmorph.images.detail import auto_sigma
from clmorph.measures.landmark_options import AUTO
from clmorph.measures.landmarks import Guided, guided
from clmorph.measures.lift import lift_pair
from clmorph.measures.measure import Measure
from clmorph.measures.options import LiftOptions
from clmorph.measures.pixel_blocks import PixelBlocks, group_pixels
from clmorph.output.playback import eased
from clmorph.pipeline.budget import check_ways, make_plan
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.guides import guides, labeled
from clmorph.pipeline.keywords import MorphKeywords
from clmorph.pipeline.maps import NO_MAPS, Maps
from clmorph.pipeline.options import NO_DIVERGENCE, MorphOptions
from clmorph.pipeline.prepare import Picture, as_images, as_options, fitted, small_copies
from clmorph.pipeline.presets import PresetName
from clmorph.pipeline.result import Morph
from clmorph.transport.barycentric import Barycentric, destination_colors
from clmorph.transport.divergence import sinkhorn_divergence
from clmorph.transport.options import SolverOptions
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import Goal, regularization
from clmorph.transport.sinkhorn import sinkhorn, warn_unless_converged
from clmorph.transport.subproblems import Subproblem, by_label, solve_parts

#: Times at which widths are optimized; widths at other times are interpolated. At the ends, where
#: particles stand on pixels, the narrowest width is the best, so the next times are near the ends.
KNOTS = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0])
#: Candidate widths in pixels. The objective can have several minima, so all candidates are tried.
#: The search then continues `REFINEMENTS` times between the neighbors of the best one.
WIDTHS = 0.1 * 2.0 ** (0.5 * np.arange(12))
REFINEMENTS = 3
#: Number of points to which the particles of frames are merged for this search.
POINTS = 4096


@documented(MorphOptions)
def morph(
    image_a: ArrayLike,
    image_b: ArrayLike,
    options: MorphOptions | None = None,
    *,
    preset: PresetName | None = None,
    draft: bool = False,
    backend: Backend = "auto",
    weights: tuple[ArrayLike | None, ArrayLike | None] | None = None,
    color_metric: ArrayLike | None = None,
    labels: tuple[ArrayLike, ArrayLike] | Literal["auto"] | None = None,
    features: tuple[ArrayLike, ArrayLike] | None = None,
    progress: StageProgress | None = None,
    **given: Unpack[MorphKeywords],
) -> Morph:
    """Morph one image into another by unbalanced optimal transport.

    Parameters
    ----------
    image_a, image_b : arrays
        See `clmorph.images.pixels.as_pixels`. They may have any sizes and are first reduced to
        `size`.
    options : MorphOptions, optional
        All options at once; options given by name replace those of this object.
    preset : str, optional
        The name of the set of options (`clmorph.pipeline.presets.PRESETS`) from which those given
        by name differ. By default "auto": "pixel-art" if both images are sprites, "logo" if both
        are flat drawings or sprites, and "photo" otherwise (`clmorph.images.kind.kind_of`).
    draft : bool
        A first look in a few seconds (by NumPy in up to a minute): smaller, with fewer frames and
        less accuracy, as far as these options are not given (`clmorph.pipeline.presets.DRAFT`).
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.
    weights : (map_a, map_b), optional
        Maps (H, W) of mass, which replace `mass` and are not normalized. If one of them is None,
        `mass` gives its distribution, with the total of the other map.
    color_metric : (3, 3), (H, W, 3, 3) or (H, W) array, optional
        Metric with which the cost compares colors, see `clmorph.lift`; a map has one entry for
        each pixel of image_a.
    labels : (labels_a, labels_b), optional
        Integer arrays (H, W) of the shapes of image_a and image_b as they are given. Mass never
        changes its label, exactly; a label that only one image has does not move and fades as
        unmatched mass does. See `clmorph.read_labels`. "auto": a person before a background, which
        the extra ``faces`` finds, or what is not transparent; nothing if an image has neither.
    features : (features_a, features_b), optional
        Arrays (H, W) or (H, W, K) of the shapes of the images as they are given: further
        coordinates of the cost, weighted by `feature_weight`, at most six beside position and
        color (and landmarks).
    progress : callable, optional
        A function that is called with a stage's name and the share of it that is done.
    {options}

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

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> red, blue = np.zeros((2, 6, 6, 3))
    >>> red[1:3, 1:3, 0] = 1
    >>> blue[3:5, 2:6, 2] = 1
    >>> result = clmorph.morph(red, blue, n_frames=5, backend="numpy")
    >>> len(result.frames), result.frame(0.5).shape
    (5, (6, 6, 3))
    >>> bool(np.abs(result.frame(0.0) - red).max() < 1e-6)
    True
    """
    images = as_images((image_a, image_b))
    chosen = as_options(options, preset, given, images, draft=draft)
    pair = ImagePair.of(images, chosen, Maps(weights, color_metric, labels, features))
    return pair.morph(backend, check_progress(progress))


@dataclass(frozen=True)
class ImagePair:
    """Two images at the size at which they are drawn (`fitted`), and the options of their morph."""

    images: Sequence[Picture]
    options: MorphOptions
    #: Shapes (height, width) of the images as they were given, in whose pixels landmarks are, and
    #: which labels and features have; those of `images` if missing.
    shapes: Sequence[tuple[int, int]] | None = None
    maps: Maps = NO_MAPS
    #: What landmarks were found, in a line (`clmorph.pipeline.guides`).
    found: str = ""

    @classmethod
    def of(cls, images: Sequence[AnyArray], options: MorphOptions, maps: Maps) -> ImagePair:
        """Find what is wanted in two images, labels and landmarks, and fit these to their size."""
        maps, _ = labeled(images, maps)
        guide = guides(images, [(0, 1)], options, maps)
        shown = fitted(images, options, maps)
        return cls(shown, guide.of(0), shapes_of(images), maps, guide.found)

    @property
    def given_shapes(self) -> Sequence[tuple[int, int]]:
        """Shapes of the images as they were given."""
        return self.shapes or shapes_of(self.images)

    def measures(self, images: Sequence[Picture] | None = None) -> Guided:
        """Lift both images, or copies of them, with the misses of landmarks."""
        first, second = self.images if images is None else images
        maps, options = self.maps, self.options
        measures = lift_pair(
            (first, second), weights=maps.weights, color_metric=maps.color_metric,
            **options.of(LiftOptions),
        )  # fmt: skip
        measures = maps.added(measures, self.given_shapes, options.feature_weight)
        landmarks: Any = options.landmarks or ()
        assert landmarks != AUTO  # `guides` has found them
        return guided(*measures, landmarks, self.given_shapes)

    @property
    def _goal(self) -> Goal:
        return regularization(**self.options.of(SolverOptions))

    def parts(
        self, source: Measure, target: Measure
    ) -> tuple[tuple[PixelBlocks, PixelBlocks], list[Subproblem]]:
        """Group pixels into blocks; return these, and the problem, or one for each label."""
        most = self.options.solve_size
        blocks = group_pixels(source, most), group_pixels(target, most)
        labels = self.maps.labels_of((source, target), self.given_shapes)
        if labels is None:
            return blocks, [Subproblem(*blocks)]
        return blocks, by_label(source, target, labels, most, self._goal)

    def labels(self, source: Measure, target: Measure) -> tuple[IntArray, IntArray] | None:
        """Return the labels of the pixels, (N,) and (M,); None if there are none."""
        labels = self.maps.labels_of((source, target), self.given_shapes)
        return None if labels is None else (labels[0].ravel(), labels[1].ravel())

    def solve(
        self,
        parts: Sequence[Subproblem],
        masses: tuple[float, float],
        operations: Operations,
        report: Progress,
    ) -> tuple[list[Potentials], Potentials]:
        """Return the potentials of each part that `parts` returned, and those of all together."""
        options = self.options
        if parts[0].points is None:
            found = sinkhorn(
                *parts[0].measures, backend=members_of(operations)[0], progress=report,
                **options.of(SolverOptions),
            )  # fmt: skip
            return [found], found
        solved, whole = solve_parts(parts, masses, self._goal, operations, report)
        warn_unless_converged(whole.status, whole.message, 5)
        return solved, whole

    def morph(self, backend: Backend, report: StageProgress) -> Morph:
        """Solve the transport, make its particles, and choose the kernel widths."""
        options = self.options
        small = small_copies(self.images, options, self.maps)
        source, target, misses = self.measures(small)
        if options.sigma is not None and source.has_metric_map:
            raise InputError(NO_DIVERGENCE)
        if options.barycentric:
            destination_colors(source, target)  # raises an error if there can be none
        blocks, parts = self.parts(source, target)
        operations = get_backend(backend)
        check_ways(*blocks, operations, options)
        report("transport", 0.0)
        solved, potentials = self.solve(
            parts, (source.mass, target.mass), operations, lambda share: report("transport", share)
        )
        report("plan", 0.0)
        plan = make_plan(parts, solved, operations, options)
        report("plan", 1.0)
        # Large pictures are held for as long as the film is.
        shown = [image.astype(np.float32) for image in self.images] if small else []
        result = Morph(
            source=source,
            target=target,
            potentials=replace(potentials, passes=None),  # the plan is made
            plan=plan,
            particles=replace(
                particles(
                    source, target, plan, unmatched=options.unmatched,
                    path_space=options.path_space,
                ),
                labels=self.labels(source, target),
            ),
            times=eased(np.linspace(0.0, 1.0, options.n_frames), options.ease),
            kernel_width=self._kernel_width(small or self.images, source, target, plan),
            operations=operations,
            endpoints=options.endpoints,
            unmatched=options.unmatched,
            options=options,
            arrays=self.maps.names,
            shapes=(self.given_shapes[0], self.given_shapes[1]),
            pictures=None if small is None else (shown[0], shown[1]),
            found=self.found,
            misses=misses,
        )  # fmt: skip
        if options.sigma is None:
            return result
        curve = optimal_curve(result, lambda share: report("width", share))
        return replace(result, kernel_width=replace(result.kernel_width, curve=curve))

    def _kernel_width(
        self, lifted: Sequence[Picture], source: Measure, target: Measure, plan: Plan | Barycentric
    ) -> KernelWidth:
        """Return the kernel's width over time (Eq. 3 and 4), in pixels of the frames."""
        options = self.options
        start, end = (
            auto_sigma(image) * max(shown.shape) / max(image.shape)
            if width == "auto"
            else float(width)
            for width, image, shown in zip(
                (options.sigma_start, options.sigma_end), lifted, self.images, strict=True
            )
        )
        # N_eff (Eq. 3) of the masses that are drawn at both ends.
        drawn = (source.weights, target.weights)
        first, last = map(effective_count, plan.marginals if options.unmatched == "drop" else drawn)
        return KernelWidth(start, end, options.gamma or 0.0, first, last, options.splatting)


def shapes_of(images: Sequence[Picture]) -> list[tuple[int, int]]:
    """Return the height and the width of each image."""
    return [(image.shape[0], image.shape[1]) for image in images]


def optimal_curve(
    morph: Morph, report: Callable[[float], None]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the kernel widths, times and pixels, whose frames are nearest to the particles.

    The Sinkhorn divergence decides (paper, 4.3). Torn pixels are closed. The divergence prefers
    grain to blur: an average is a color of no particle.
    """
    widths = []
    for number, t in enumerate(KNOTS):
        objective = _objective(morph, float(t))
        tried = [(objective(width), float(width)) for width in WIDTHS]
        step = float(np.sqrt(WIDTHS[1] / WIDTHS[0]))
        for _ in range(REFINEMENTS):
            best = min(tried)[1]
            tried += [(objective(width), width) for width in (best / step, best * step)]
            step = float(np.sqrt(step))
        widths.append(min(tried)[1])
        report((number + 1) / len(KNOTS))
    return KNOTS, np.array(widths)


def _objective(morph: Morph, t: float) -> Callable[[float], float]:
    """Return the divergence of the frame at t to its particles, as a function of the width."""
    particles, _ = particle_measure(morph, t, max_points=POINTS)
    blur, reach = morph.potentials.blur, morph.potentials.reach
    assert not isinstance(reach, tuple)  # the options have been checked
    local, device = morph.kernel_width.splatting == "local", members_of(morph.operations)[0]

    def divergence(width: float) -> float:
        sums = morph.sums(t, widths=Widths(width, local, closed=True))
        frame = frame_measure(morph, t, sums=sums)
        return float(sinkhorn_divergence(frame, particles, blur, reach, backend=device))

    return divergence
