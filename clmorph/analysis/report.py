"""The results of an inspection, as numbers and as text."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.printable import percent, size_text, time_text
from clmorph._shared.typing import Array
from clmorph.measures.measure import Measure
from clmorph.pipeline.memory import Memory
from clmorph.transport.displacement import Displacement
from clmorph.transport.divergence import Divergence
from clmorph.transport.plan import BYTES_PER_PAIR, Plan
from clmorph.transport.potentials import Potentials

#: Bytes of a particle (two row numbers of the table, two masses) and of a row of the table.
BYTES_PER_PARTICLE, BYTES_PER_END = 24, 48


class Seconds(NamedTuple):
    """Durations of the stages in seconds, measured or estimated."""

    #: Measured duration of the solver.
    transport: float
    #: Duration of counting and writing pairs; measured if there is a plan, else partly estimated.
    plan: float
    #: Estimated duration of making particles and all frames, without writing a file; see
    #: `clmorph.analysis.timing.frame_seconds`.
    frames: float


class Marks(NamedTuple):
    """Landmarks of both images."""

    #: Pairs ((x, y), (x', y')) in pixels of the images as they were given.
    pairs: Sequence[tuple[tuple[float, float], tuple[float, float]]] = ()
    #: Shapes (height, width) of these images.
    shapes: Sequence[tuple[int, int]] = ()
    #: (n,) How far the warp misses the partners of landmarks, in pixels of the second image.
    misses: Array = np.zeros(0)
    #: What ``landmarks="auto"`` has found; "" if it found nothing or was not asked.
    found: str = ""

    @property
    def text(self) -> str:
        """What landmarks there are, in a few words; "" if there are none."""
        if not len(self.pairs):
            return ""
        number = "one point" if len(self.pairs) == 1 else f"{len(self.pairs)} points"
        missed = f"; missed by up to {self.misses.max():.2g} px" if self.misses.max() > 0.05 else ""
        return (self.found or number) + missed


@dataclass(frozen=True, repr=False, eq=False)
class Report:
    """What an inspection has measured; `Inspection` describes the attributes, and draws them."""

    source: Measure
    target: Measure
    potentials: Potentials
    plan: Plan | None
    pairs: int
    displacement: Displacement
    divergence: Divergence | None
    no_divergence: str
    memory: Memory
    seconds: Seconds
    n_frames: int
    moving: int
    shapes: tuple[tuple[int, int], tuple[int, int]]
    device: str
    marks: Marks

    def __repr__(self) -> str:
        (h, w), (height, width) = self.source.shape, self.target.shape
        return (
            f"<Inspection of {w} x {h} into {width} x {height} pixels, {self.pairs} pairs, "
            f"{self.potentials.message}>"
        )

    @property
    def pair_bytes(self) -> int:
        """Bytes of the plan, if all its pairs are kept."""
        return self.pairs * BYTES_PER_PAIR + 8 * (len(self.source) + 1)

    @property
    def particles(self) -> int:
        """Number of particles that a morph would draw: pairs, and mass that dies or is born."""
        moved = self.displacement
        resting = 0
        ends = zip((moved.destroyed, moved.created), self.shapes, strict=True)
        for masses, (height, width) in ends:
            resting += int(np.count_nonzero(masses)) * height * width // masses.size
        return self.moving + resting

    @property
    def particle_bytes(self) -> int:
        """Bytes of these particles."""
        ends = sum(height * width for height, width in self.shapes)
        return self.particles * BYTES_PER_PARTICLE + ends * BYTES_PER_END

    @property
    def transported(self) -> float:
        """Mass that travels, as a share of the source's; more than 1 if transport adds to it."""
        return float(self.displacement.source_mass.sum()) / self.source.mass

    @property
    def destroyed(self) -> float:
        """Share of the source's mass that dies at its place."""
        return float(self.displacement.destroyed.sum()) / self.source.mass

    @property
    def created(self) -> float:
        """Share of the target's mass that is born at its place."""
        return float(self.displacement.created.sum()) / self.target.mass

    def summary(self) -> dict[str, Any]:
        """Return all numbers as values that `json.dumps` accepts: finite, or None.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> found = clmorph.inspect(left, right, blur=0.1, reach=0.3, backend="numpy")
        >>> sorted(found.summary()["mass"])
        ['created', 'destroyed', 'transported']
        """
        found, moved, plan = self.potentials, self.displacement, self.plan
        reach = found.reach if isinstance(found.reach, tuple) else (found.reach, found.reach)
        bounds = None
        if self.divergence is not None:
            low, high = self.divergence.interval
            bounds = {"value": self.divergence.value, "low": low, "high": high}
        result: dict[str, Any] = {
            "device": self.device,
            "source": _measure_summary(self.source),
            "target": _measure_summary(self.target),
            "drawn": [{"height": height, "width": width} for height, width in self.shapes],
            "options": {
                "blur": found.blur,
                "reach": list(reach),
                **_named(self.source, "color_weight", "color_space", "extent"),
            },
            "solver": {
                **_named(found, "status", "message"),
                "iterations": found.n_iter,
                **_named(found, "residual", "primal", "dual", "gap", "marginal_error"),
            },
            "mass": _named(self, "transported", "destroyed", "created"),
            "displacement_pixels": _named(moved, "max", "mean", "mass_weighted_mean"),
            "divergence": bounds,
            "no_divergence": self.no_divergence or None,
            "landmarks": {
                "pairs": [[list(point) for point in pair] for pair in self.marks.pairs],
                "misses": self.marks.misses.tolist(),
                "found": self.marks.found or None,
            },
            "plan": {
                "pairs": self.pairs,
                "bytes": self.pair_bytes,
                "built": plan is not None,
                "dropped_mass": None if plan is None else plan.dropped_mass,
            },
            "particles": {"count": self.particles, "bytes": self.particle_bytes},
            "memory_bytes": _named(self.memory, "host", "device", "shared"),
            "seconds": {
                "transport": self.seconds.transport,
                "plan": self.seconds.plan,
                "plan_estimated": plan is None,
                "frames_estimated": self.seconds.frames,
                "n_frames": self.n_frames,
            },
        }
        return _finite(result)

    def lines(self) -> list[str]:
        """Return the main numbers as readable lines, one for each.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> found = clmorph.inspect(left, right, blur=0.1, reach=0.3, backend="numpy")
        >>> found.lines()[0]
        'source        6 x 6 pixels'
        """
        return [f"{label:<13} {text}" for label, text in self.entries()]

    def entries(self) -> list[tuple[str, str]]:
        """Return the main numbers as labels and texts.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> found = clmorph.inspect(left, right, blur=0.1, reach=0.3, backend="numpy")
        >>> found.entries()[0]
        ('source', '6 x 6 pixels')
        """
        moved, plan, seconds = self.displacement, self.plan, self.seconds
        bounds = f"gap {self.potentials.gap:.2g}" if self.potentials.reach is not None else (
            f"marginals off by {self.potentials.marginal_error:.2g}"
        )  # fmt: skip
        if self.divergence is None:
            divergence = f"none: {self.no_divergence}"
        else:
            low, high = self.divergence.interval
            divergence = f"{self.divergence.value:.5g}, within [{low:.5g}, {high:.5g}]"
        unit, point = (
            ("px", "pixel") if self.source.shape == self.shapes[0] else ("blocks", "block")
        )
        kept = f"{self.pairs} pairs, {self.pairs / len(self.source):.0f} to a {point}"
        if plan is None:
            built = f"{size_text(self.pair_bytes)}: more than it may take"
        else:
            built = f"{size_text(self.pair_bytes)}, {percent(plan.dropped_mass)} of mass dropped"
        where = "in all" if self.memory.shared else "on the host"
        memory = f"about {size_text(self.memory.ram)} {where}"
        if not self.memory.shared:
            memory += f", {size_text(self.memory.device)} on the device"
        about = "" if plan is not None else "about "
        marks = self.marks.text
        return [
            ("source", _measure_text(self.source, self.shapes[0])),
            ("target", _measure_text(self.target, self.shapes[1])),
            *([("landmarks", marks)] if marks else []),
            ("solver", self.potentials.message),
            ("certificate", f"value {self.potentials.dual:.5g}, {bounds}"),
            ("transported", f"{percent(self.transported)} of the source's mass"),
            ("destroyed", f"{percent(self.destroyed)} of the source's mass"),
            ("created", f"{percent(self.created)} of the target's mass"),
            (
                "displacement",
                f"mean {moved.mass_weighted_mean:.3g} {unit}, at most {moved.max:.3g} {unit}",
            ),
            ("divergence", divergence),
            ("plan", f"{kept}, {built}"),
            ("particles", f"{self.particles}, {size_text(self.particle_bytes)}"),
            ("memory", f"{memory}, for a morph"),
            (
                "time",
                f"transport {time_text(seconds.transport)}, plan {about}{time_text(seconds.plan)}, "
                f"{self.n_frames} frames about {time_text(seconds.frames)}",
            ),
            ("device", self.device),
        ]


def _named(of: Any, *names: str) -> dict[str, Any]:
    """Return some attributes by their names."""
    return {name: getattr(of, name) for name in names}


def _measure_summary(measure: Measure) -> dict[str, Any]:
    height, width = measure.shape
    return {
        "height": height,
        "width": width,
        "points": len(measure),
        "points_with_mass": int(np.count_nonzero(measure.weights)),
        "mass": measure.mass,
    }


def _measure_text(measure: Measure, drawn: tuple[int, int]) -> str:
    height, width = measure.shape
    seen = int(np.count_nonzero(measure.weights))
    some = "" if seen == len(measure) else f", {seen} of them with mass"
    if measure.shape == drawn:
        return f"{width} x {height} pixels{some}"
    return f"{drawn[1]} x {drawn[0]} pixels in {width} x {height} blocks{some}"


def _finite(value: Any) -> Any:
    """Replace numbers that JSON cannot represent by None."""
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
