"""Morph one image into another by unbalanced optimal transport, on any OpenCL device."""

from importlib.metadata import version

from clmorph import reference
from clmorph.backends import get_backend
from clmorph.displacement import Displacement, displacement_statistics
from clmorph.divergence import Divergence, sinkhorn_divergence
from clmorph.errors import (
    ClmorphError,
    ConvergenceWarning,
    DeviceError,
    ImageWarning,
    InputError,
    MemoryWarning,
    OutputError,
    PlanSizeError,
)
from clmorph.export import save
from clmorph.formats.archive import Archive, load
from clmorph.images import fit, read_image
from clmorph.inspection import Inspection, inspect
from clmorph.interpolation import Particles, particles
from clmorph.measures import Measure, lift
from clmorph.morph import morph
from clmorph.plan import Plan, transport_plan
from clmorph.points import WeightedPoints
from clmorph.potentials import Potentials
from clmorph.result import Morph
from clmorph.sampling import Barycentric, barycentric_plan, sample_plan
from clmorph.sinkhorn import sinkhorn

__version__ = version("clmorph")

__all__ = [
    "Archive",
    "Barycentric",
    "ClmorphError",
    "ConvergenceWarning",
    "DeviceError",
    "Displacement",
    "Divergence",
    "ImageWarning",
    "InputError",
    "Inspection",
    "Measure",
    "MemoryWarning",
    "Morph",
    "OutputError",
    "Particles",
    "Plan",
    "PlanSizeError",
    "Potentials",
    "WeightedPoints",
    "barycentric_plan",
    "displacement_statistics",
    "fit",
    "get_backend",
    "inspect",
    "lift",
    "load",
    "morph",
    "particles",
    "read_image",
    "reference",
    "sample_plan",
    "save",
    "sinkhorn",
    "sinkhorn_divergence",
    "transport_plan",
]
