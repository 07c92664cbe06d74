from . import batch, reference
from ._shared.version import __version__
from .adapters import geomloss, jax, pot, torch
from .analysis.inspect import inspect
from .analysis.inspection import Inspection
from .backends.select import get_backend
from .errors import (
    ClmorphError,
    ClmorphWarning,
    ConvergenceWarning,
    DeviceError,
    FileError,
    ImageWarning,
    InputError,
    MemoryWarning,
    OptionWarning,
    OutputError,
    PlanSizeError,
    PruningWarning,
)
from .frames.density_path import DensityPath, density_path
from .frames.particles import Particles, particles
from .images.label_maps import read_labels
from .images.looks import Lut, read_lut
from .images.pixels import fit, read_image
from .measures.grid import Grid, grid_measure
from .measures.lift import density, lift
from .measures.measure import Measure
from .measures.points import WeightedPoints
from .output.formats.archive import Archive, load
from .output.luts import write_lut
from .output.picture import write_image
from .output.save import save
from .pipeline.clip_morph import morph_clip
from .pipeline.clips import recolor_clip
from .pipeline.luts import apply_lut, fit_lut
from .pipeline.mixing.mix import mix
from .pipeline.mixing.mixes import Mixes
from .pipeline.morph import morph
from .pipeline.options import MorphOptions
from .pipeline.rearrange import Rearrangement, rearrange
from .pipeline.rearrange_options import RearrangeOptions
from .pipeline.recipe import load_options
from .pipeline.recolor import Recolored, recolor
from .pipeline.recolor_options import RecolorOptions
from .pipeline.result import Morph
from .transport.barycenters.barycenter import barycenter
from .transport.barycenters.result import Barycenter
from .transport.barycentric import Barycentric, barycentric_plan
from .transport.displacement import (
    Displacement,
    DisplacementField,
    displacement_field,
    displacement_statistics,
)
from .transport.divergence import Divergence, sinkhorn_divergence
from .transport.divergence_batch import (
    DivergenceMatrix,
    divergence_matrix,
    sinkhorn_divergence_batch,
)
from .transport.gradient import Gradient, gradient
from .transport.hessian import hessian_product
from .transport.matching import Assignment, assignment
from .transport.plan import Plan
from .transport.plan_building import transport_plan
from .transport.plan_sampling import sample_plan
from .transport.potentials import Potentials
from .transport.sinkhorn import sinkhorn
from .transport.sinkhorn_batch import PotentialsBatch, sinkhorn_batch

__all__ = [
    "__version__",
    "Archive",
    "Assignment",
    "Barycenter",
    "Barycentric",
    "ClmorphError",
    "ClmorphWarning",
    "ConvergenceWarning",
    "DensityPath",
    "DeviceError",
    "Displacement",
    "DisplacementField",
    "Divergence",
    "DivergenceMatrix",
    "FileError",
    "Gradient",
    "Grid",
    "ImageWarning",
    "Lut",
    "OptionWarning",
    "InputError",
    "Inspection",
    "Measure",
    "MemoryWarning",
    "Mixes",
    "Morph",
    "MorphOptions",
    "OutputError",
    "Particles",
    "Plan",
    "PlanSizeError",
    "Potentials",
    "PotentialsBatch",
    "PruningWarning",
    "RearrangeOptions",
    "Rearrangement",
    "RecolorOptions",
    "Recolored",
    "WeightedPoints",
    "apply_lut",
    "assignment",
    "barycenter",
    "barycentric_plan",
    "batch",
    "density",
    "density_path",
    "displacement_field",
    "displacement_statistics",
    "divergence_matrix",
    "fit",
    "fit_lut",
    "geomloss",
    "get_backend",
    "gradient",
    "grid_measure",
    "hessian_product",
    "inspect",
    "jax",
    "lift",
    "load",
    "load_options",
    "mix",
    "morph",
    "morph_clip",
    "particles",
    "pot",
    "read_image",
    "read_lut",
    "read_labels",
    "rearrange",
    "recolor",
    "recolor_clip",
    "reference",
    "sample_plan",
    "save",
    "sinkhorn",
    "sinkhorn_batch",
    "sinkhorn_divergence",
    "sinkhorn_divergence_batch",
    "torch",
    "transport_plan",
    "write_image",
    "write_lut",
]
