from . import batch as batch
from . import reference as reference
from ._shared.version import (
    __version__ as __version__,
)
from .adapters import (
    geomloss as geomloss,
)
from .adapters import (
    jax as jax,
)
from .adapters import (
    pot as pot,
)
from .adapters import (
    torch as torch,
)
from .analysis.inspect import (
    inspect as inspect,
)
from .analysis.inspection import (
    Inspection as Inspection,
)
from .backends.select import (
    get_backend as get_backend,
)
from .errors import (
    ClmorphError as ClmorphError,
)
from .errors import (
    ClmorphWarning as ClmorphWarning,
)
from .errors import (
    ConvergenceWarning as ConvergenceWarning,
)
from .errors import (
    DeviceError as DeviceError,
)
from .errors import (
    FileError as FileError,
)
from .errors import (
    ImageWarning as ImageWarning,
)
from .errors import (
    InputError as InputError,
)
from .errors import (
    MemoryWarning as MemoryWarning,
)
from .errors import (
    OptionWarning as OptionWarning,
)
from .errors import (
    OutputError as OutputError,
)
from .errors import (
    PlanSizeError as PlanSizeError,
)
from .errors import (
    PruningWarning as PruningWarning,
)
from .frames.density_path import (
    DensityPath as DensityPath,
)
from .frames.density_path import (
    density_path as density_path,
)
from .frames.particles import (
    Particles as Particles,
)
from .frames.particles import (
    particles as particles,
)
from .images.label_maps import (
    read_labels as read_labels,
)
from .images.looks import (
    Lut as Lut,
)
from .images.looks import (
    read_lut as read_lut,
)
from .images.pixels import (
    fit as fit,
)
from .images.pixels import (
    read_image as read_image,
)
from .measures.density import (
    density as density,
)
from .measures.grid import (
    Grid as Grid,
)
from .measures.grid import (
    grid_measure as grid_measure,
)
from .measures.lift import (
    lift as lift,
)
from .measures.measure import (
    Measure as Measure,
)
from .measures.points import (
    WeightedPoints as WeightedPoints,
)
from .output.formats.archive import (
    Archive as Archive,
)
from .output.formats.archive import (
    load as load,
)
from .output.luts import (
    write_lut as write_lut,
)
from .output.picture import (
    write_image as write_image,
)
from .output.save import (
    save as save,
)
from .pipeline.clip_morph import (
    morph_clip as morph_clip,
)
from .pipeline.clips import (
    recolor_clip as recolor_clip,
)
from .pipeline.luts import (
    apply_lut as apply_lut,
)
from .pipeline.luts import (
    fit_lut as fit_lut,
)
from .pipeline.mixing.mix import (
    mix as mix,
)
from .pipeline.mixing.mixes import (
    Mixes as Mixes,
)
from .pipeline.morph import (
    morph as morph,
)
from .pipeline.options import (
    MorphOptions as MorphOptions,
)
from .pipeline.rearrange import (
    rearrange as rearrange,
)
from .pipeline.rearrange_options import (
    RearrangeOptions as RearrangeOptions,
)
from .pipeline.rearrangement import (
    Rearrangement as Rearrangement,
)
from .pipeline.recipe import (
    load_options as load_options,
)
from .pipeline.recolor import (
    recolor as recolor,
)
from .pipeline.recolor_options import (
    RecolorOptions as RecolorOptions,
)
from .pipeline.recolored import (
    Recolored as Recolored,
)
from .pipeline.result import (
    Morph as Morph,
)
from .transport.barycenters.barycenter import (
    barycenter as barycenter,
)
from .transport.barycenters.result import (
    Barycenter as Barycenter,
)
from .transport.barycentric import (
    Barycentric as Barycentric,
)
from .transport.barycentric import (
    barycentric_plan as barycentric_plan,
)
from .transport.displacement import (
    Displacement as Displacement,
)
from .transport.displacement import (
    displacement_statistics as displacement_statistics,
)
from .transport.displacement_field import (
    DisplacementField as DisplacementField,
)
from .transport.displacement_field import (
    displacement_field as displacement_field,
)
from .transport.divergence import (
    Divergence as Divergence,
)
from .transport.divergence import (
    sinkhorn_divergence as sinkhorn_divergence,
)
from .transport.divergence_batch import (
    sinkhorn_divergence_batch as sinkhorn_divergence_batch,
)
from .transport.divergence_matrix import (
    DivergenceMatrix as DivergenceMatrix,
)
from .transport.divergence_matrix import (
    divergence_matrix as divergence_matrix,
)
from .transport.gradient import (
    Gradient as Gradient,
)
from .transport.gradient import (
    gradient as gradient,
)
from .transport.hessian import (
    hessian_product as hessian_product,
)
from .transport.matching import (
    Assignment as Assignment,
)
from .transport.matching import (
    assignment as assignment,
)
from .transport.plan import (
    Plan as Plan,
)
from .transport.plan_building import (
    transport_plan as transport_plan,
)
from .transport.plan_sampling import (
    sample_plan as sample_plan,
)
from .transport.potentials import (
    Potentials as Potentials,
)
from .transport.potentials_batch import (
    PotentialsBatch as PotentialsBatch,
)
from .transport.sinkhorn import (
    sinkhorn as sinkhorn,
)
from .transport.sinkhorn_batch import (
    sinkhorn_batch as sinkhorn_batch,
)

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
    "get_backend",
    "gradient",
    "grid_measure",
    "hessian_product",
    "inspect",
    "lift",
    "load",
    "load_options",
    "mix",
    "morph",
    "particles",
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
    "transport_plan",
    "write_image",
    "write_lut",
]
