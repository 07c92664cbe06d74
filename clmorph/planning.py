"""Which particles a morph is made of: all kept pairs, draws or means, within some memory."""

import warnings
from typing import Any

from clmorph.errors import MemoryWarning
from clmorph.estimates import affordable, estimate, predict_pairs
from clmorph.operations import Operations
from clmorph.plan import Plan, transport_plan
from clmorph.potentials import Potentials
from clmorph.refinement import PixelCells, drawn, refined
from clmorph.sampling import MAX_DRAWS, Barycentric, barycentric_plan, sample_plan

#: Share of a device's memory that a morph may take, unless told otherwise.
MEMORY_SHARE = 0.5


def default_memory(operations: Operations) -> float | None:
    """Return how many bytes a morph may take; None if the backend does not say what it has."""
    device = getattr(operations, "device", None)
    return None if device is None else MEMORY_SHARE * float(device.global_mem_size)


def make_plan(
    source: PixelCells,
    target: PixelCells,
    potentials: Potentials,
    operations: Operations,
    *,
    sample: int | None = None,
    barycentric: bool = False,
    seed: int = 0,
    max_particles: int | None = None,
    max_memory: float | None = None,
) -> Plan | Barycentric:
    """Return the plan between two images' pixels in the form that was asked for, or that fits.

    Parameters
    ----------
    source, target : PixelCells
    potentials : Potentials
        Of `source.coarse` and `target.coarse`.
    operations : Operations
    sample, barycentric, seed
        See `clmorph.morph`; without either all pairs are kept, if they fit.
    max_particles : int, optional
        If there are more pairs, about so many are drawn, but at least one a pixel.
    max_memory : float, optional
        Bytes that the morph may take; None is `default_memory`.

    Warns
    -----
    MemoryWarning
        If not all pairs fit; it says what is done in their place.
    """
    measures = source.coarse, target.coarse
    if sample is None and not barycentric:
        way = _way(source, target, potentials, operations, max_particles, max_memory)
        sample, barycentric = way.get("sample"), way.get("barycentric", False)
    plan: Plan | Barycentric
    if barycentric:
        plan = barycentric_plan(*measures, potentials, backend=operations)
    elif sample is not None:
        # Each pixel of a cell has draws of its own, if there can be so many.
        draws = min(MAX_DRAWS, sample * max(source.side, target.side) ** 2)
        plan = sample_plan(*measures, potentials, draws, seed=seed, backend=operations)
        return plan if draws == sample else drawn(plan, source, target, draws)
    else:
        plan = transport_plan(*measures, potentials, backend=operations)
    return refined(plan, source, target)


def _way(
    source: PixelCells,
    target: PixelCells,
    potentials: Potentials,
    operations: Operations,
    max_particles: int | None,
    max_memory: float | None,
) -> dict[str, Any]:
    """Return options of the plan within both limits; none if all pairs may be kept."""
    finest = max(source.side, target.side) ** 2
    most = len(source.coarse) * len(target.coarse) * finest
    limit = default_memory(operations) if max_memory is None else max_memory
    fine = source.fine, target.fine
    shapes = fine[0].shape, fine[1].shape
    kind: dict[str, Any] = {
        "alpha": any(measure.alpha is not None for measure in fine),
        "dimension": 11 if fine[0].has_metric_map else 5,
        "backend": operations,
    }
    need = estimate(*shapes, most, **kind)
    few = max_particles is None or most <= max_particles
    if few and (limit is None or max(need.ram, need.device) <= limit):
        return {}  # whatever it keeps
    pairs = finest * predict_pairs(source.coarse, target.coarse, potentials, backend=operations)
    wanted: dict[str, Any] = {}
    if max_particles is not None and pairs > max_particles:
        wanted = {"sample": max(1, min(MAX_DRAWS, max_particles // (len(source.coarse) * finest)))}
        pairs = wanted["sample"] * len(source.coarse) * finest
    if limit is None:
        return wanted
    way = affordable(limit, *shapes, pairs, **kind)
    if not way:
        return wanted
    chosen = f"sample={way['sample']}" if "sample" in way else "barycentric=True"
    warnings.warn(
        f"the plan's {pairs:.2g} pairs would not fit into max_memory={limit / 1e9:.3g} GB: "
        f"{chosen} is taken in their place",
        MemoryWarning,
        stacklevel=4,
    )
    return way
