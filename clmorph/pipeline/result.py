"""A morph: what the transport found, and its frames, rendered when asked for."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.validation import check_number, shown
from clmorph.backends.interface import Operations
from clmorph.errors import InputError
from clmorph.frames.endpoints import EndCorrection, Lacking, ladder, make_details
from clmorph.frames.kernel_width import KernelWidth
from clmorph.frames.opacity import matter, opacity
from clmorph.frames.particles import Particles
from clmorph.frames.render import Canvas, Sums, Widths, canvas_at, render
from clmorph.images.color import from_space, to_space
from clmorph.images.detail import is_pixel_art
from clmorph.measures.measure import Measure
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials

#: Opacity that no 8 bits show.
UNSEEN = 1 / 1024


@dataclass(frozen=True, repr=False, eq=False)
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
    endpoints : {"exact", "paper"}
        Whether the first and the last frame are brought to the images themselves.
    unmatched : {"fade", "drop"}
    parameters : dict
        What `clmorph.morph` was called with; JSON takes it.
    """

    source: Measure
    target: Measure
    potentials: Potentials
    plan: Plan | Barycentric
    particles: Particles
    times: NDArray[np.float64]
    kernel_width: KernelWidth
    operations: Operations = field(repr=False)
    endpoints: str = "exact"
    unmatched: str = "fade"
    parameters: Mapping[str, Any] = field(default_factory=dict, repr=False)

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

    @cached_property
    def _matter(self) -> Particles | None:
        return matter(self.source, self.target, self.plan, self.particles)

    @cached_property
    def _uploaded_matter(self) -> Any:
        assert self._matter is not None  # asked for by those who saw that there is some
        moving = self._matter
        return self.operations.upload_particles(moving.table, moving.links, moving.weights)

    def canvas(self, t: float) -> Canvas:
        """Return the canvas at time t."""
        t = check_number("t", t, 0.0, 1.0)
        return canvas_at(t, self.source.shape, self.target.shape, self.source.extent)

    @cached_property
    def sigma(self) -> NDArray[np.float64]:
        """(n_frames,) kernel width at `times`, in pixels; 0 where there is no kernel."""
        return np.array([self.kernel_width.at(t, self.canvas(t)) for t in self.times])

    def frame(self, t: float) -> NDArray[np.float32]:
        """Render the frame at time t.

        A pixel is the weighted mean of Eq. 4 where `coverage` is at least
        `filling.HOLE_COVERAGE` (with "local" splatting, and where it is not torn out of
        its surroundings). From half of that down, where mostly the kernels' tails would decide, it
        is filled by wider kernels; between the two it is both. So it follows particles nearby,
        rather than pairs that the plan has dropped.

        Parameters
        ----------
        t : float in [0, 1]

        Returns
        -------
        (H(t), W(t), 3) float32 array
            sRGB in [0, 1]; if one of the images is not opaque all over, (H(t), W(t), 4), with
            opacity.
        """
        t = check_number("t", t, 0.0, 1.0)
        canvas = self.canvas(t)
        picture = self._picture(t, self.sums(t), self._correction)
        if self._correction is not None:
            picture = np.clip(picture + self._correction.resting(t, canvas), 0.0, 1.0)
        return picture.astype(np.float32)

    def coverage(self, t: float) -> NDArray[np.float32]:
        """Return how well the particles cover each pixel at time t, before filling.

        Returns
        -------
        (H(t), W(t)) float32 array
            Kernel mass as a share of what an even spread would give; see
            `clmorph.analysis.metrics.hole_fraction`.
        """
        return self.sums(check_number("t", t, 0.0, 1.0)).coverage.astype(np.float32)

    def sums(self, t: float, *, widths: Widths | None = None) -> Sums:
        """Render colors, coverage and density at time t, without the correction of the ends.

        Parameters
        ----------
        t : float in [0, 1]
        widths : Widths, optional
            In place of the morph's.

        Returns
        -------
        Sums
        """
        t = check_number("t", t, 0.0, 1.0)
        canvas = self.canvas(t)
        if widths is not None and not isinstance(widths, Widths):
            raise InputError(
                f"widths={shown(widths)}: expected clmorph.frames.render.Widths, or None"
            )
        if widths is not None:
            check_number("widths.sigma", widths.sigma, 0.0, 1e4)
        widths = widths or self.kernel_width.widths(t, canvas)
        # Where nothing is seen there are no holes to fill.
        fill = True if self._matter is None else self._opacity(t) > UNSEEN
        return render(
            self.operations, self._uploaded, self.particles.mass(t), t, canvas, widths, fill=fill
        )

    def _opacity(self, t: float) -> NDArray[np.float64]:
        """Return how opaque the frame at t is, ends uncorrected: (H, W) array."""
        known = self.__dict__.get("_last_opacity")
        if known is not None and known[0] == t:
            return np.asarray(known[1])
        assert self._matter is not None
        area, canvas = self._matter.mass(t), self.canvas(t)
        sums = render(
            self.operations, self._uploaded_matter, area, t, canvas,
            self.kernel_width.widths(t, canvas), fill=False,
        )  # fmt: skip
        opaque = opacity(sums, area, t)
        self.__dict__["_last_opacity"] = t, opaque
        return opaque

    def _picture(
        self, t: float, sums: Sums, correction: EndCorrection | None
    ) -> NDArray[np.float64]:
        """Colors of a frame, and its opacity if it has one; what lacks at its place left out."""
        colors = sums.colors
        if correction is not None:
            canvas = self.canvas(t)
            colors = colors + correction.moving(t, canvas, self.kernel_width.at(t, canvas))
        picture = from_space(colors, self.particles.path_space)
        if self._matter is None:
            return picture
        return np.dstack((picture, self._opacity(t)))

    @cached_property
    def _correction(self) -> EndCorrection | None:
        """What the ends lack; None if they are left as they are."""
        if self.endpoints == "paper":
            return None
        measures = self._measures
        lacking = self._lacking(0.0), self._lacking(1.0)
        details = make_details(self.operations, measures, self.plan, lacking, self.unmatched)
        correction = EndCorrection(details)
        for end, measure in enumerate(measures):
            picture = self._picture(float(end), self.sums(float(end)), correction)
            image = measure.colors.reshape(*measure.shape, 3)
            rest = image - picture[..., :3]
            if self._matter is not None:
                alpha = np.ones(measure.shape)
                if measure.alpha is not None:
                    alpha = measure.alpha.reshape(measure.shape)
                rest = np.dstack((np.where(alpha[..., None] > 0, rest, 0.0), alpha))
                rest[..., 3] -= picture[..., 3]
            correction.set_rest(end, rest)
        return correction

    def _lacking(self, end: float) -> Lacking:
        """Return what the frame at t = 0 or 1 lacks, with the widths that kernels have near it."""
        times = np.linspace(end, 0.5, 9)
        widths = ladder(np.array([self.kernel_width.at(t, self.canvas(t)) for t in times]))
        measure = self.target if end else self.source
        wanted = to_space(measure.colors, self.particles.path_space).reshape(*measure.shape, 3)
        own = self.kernel_width.widths(end, self.canvas(end))
        frames = [self.sums(end, widths=own._replace(sigma=width)).colors for width in widths]
        return Lacking(widths, wanted - np.array(frames))

    def iter_frames(self) -> Iterator[NDArray[np.float32]]:
        """Render the frames one by one, without keeping them."""
        return (self.frame(t) for t in self.times)

    @cached_property
    def frames(self) -> list[NDArray[np.float32]]:
        """All frames, at `times`; rendered at the first access, then kept."""
        return list(self.iter_frames())

    @cached_property
    def pixelated(self) -> bool:
        """Whether both images are pixel art."""
        images = []
        for measure in self._measures:
            channels = [measure.colors]
            channels += [] if measure.alpha is None else [measure.alpha[:, None]]
            images.append(np.hstack(channels).reshape(*measure.shape, -1))
        return all(is_pixel_art(image) for image in images)

    @property
    def _measures(self) -> tuple[Measure, Measure]:
        return self.source, self.target

    def save(self, path: str | PathLike[str], **options: Any) -> None:
        """Write the morph to a file chosen by its ending.

        Parameters
        ----------
        path : path
            Such as ``out.gif``, ``out.mp4`` or ``out.html``.
        **options
            See `clmorph.save`.

        Raises
        ------
        InputError
            If an option cannot be used.
        OutputError
            If it cannot be written there.
        """
        from clmorph.output.save import save

        save(self, path, **options)

    def _repr_html_(self) -> str:
        """Show the morph in a notebook, as a page to play with."""
        from clmorph.output.html import repr_html

        return repr_html(self)
