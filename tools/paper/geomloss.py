"""Table 1 by GeomLoss itself, in float64: run now, or as stored for the bundled pair."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from clmorph.errors import InputError
from clmorph.measures.measure import Measure

#: Written by ``tools/geomloss_displacements.py``.
STORED = Path(__file__).parents[2] / "tests" / "data" / "geomloss_displacements.csv"
COLUMNS = ("size", "reach", "max", "mean", "mass_weighted_mean", "mass")


def check_installed() -> None:
    """Raise an InputError if GeomLoss cannot be run here."""
    try:
        import geomloss  # noqa: F401
        import torch  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"--geomloss: {error.name} is not installed; pip install geomloss torch, or leave it"
        ) from None


def displacements(
    source: Measure, target: Measure, blur: float, reach: float | None, mask: float
) -> dict[str, float]:
    """Return max, mean, mass-weighted mean (pixels) and mass of GeomLoss's plan, made densely.

    By nothing of ours but the lifted points: potentials by GeomLoss, the plan by Eq. 2.
    """
    import torch
    from geomloss import SamplesLoss

    loss = SamplesLoss(
        "sinkhorn", p=2, blur=blur, reach=reach, scaling=0.9, debias=False, potentials=True,
        backend="tensorized",
    )  # fmt: skip
    arrays = source.weights, source.points, target.weights, target.points
    f, g = (part.numpy().ravel() for part in loss(*(torch.tensor(a)[None] for a in arrays)))
    x, y = source.points, target.points
    cost = 0.5 * (np.sum(x**2, axis=1)[:, None] + np.sum(y**2, axis=1) - 2 * x @ y.T)
    plan = np.exp((f[:, None] + g - cost) / blur**2) * source.weights[:, None] * target.weights
    mass = plan.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        arrival = plan @ target.positions / mass[:, None]
    height, width = source.shape
    length = np.linalg.norm((arrival - source.positions) * (width, height), axis=1)
    masked = np.where(mass > mask, length, 0.0)
    return {
        "max": float(masked.max()),
        "mean": float(masked.mean()),
        "mass_weighted_mean": float(np.nansum(length * mass) / mass.sum()),
        "mass": float(mass.sum()),
    }


def stored(size: int) -> dict[float | None, dict[str, float]]:
    """Return what is stored for the bundled pair at a size, by reach; empty if nothing is."""
    if not STORED.is_file():
        return {}
    with STORED.open(newline="") as file:
        rows: list[dict[str, Any]] = list(csv.DictReader(file))
    return {
        None if row["reach"] == "balanced" else float(row["reach"]): {
            name: float(row[name]) for name in COLUMNS[2:]
        }
        for row in rows
        if int(row["size"]) == size
    }
