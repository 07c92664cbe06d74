from . import reference as reference
from .backends import (
    get_backend as get_backend,
)
from .displacement import (
    Displacement as Displacement,
)
from .displacement import (
    displacement_statistics as displacement_statistics,
)
from .divergence import (
    Divergence as Divergence,
)
from .divergence import (
    sinkhorn_divergence as sinkhorn_divergence,
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
    OutputError as OutputError,
)
from .errors import (
    PlanSizeError as PlanSizeError,
)
from .errors import (
    PruningWarning as PruningWarning,
)
from .export import (
    save as save,
)
from .formats.archive import (
    Archive as Archive,
)
from .formats.archive import (
    load as load,
)
from .images import (
    fit as fit,
)
from .images import (
    read_image as read_image,
)
from .inspection import (
    Inspection as Inspection,
)
from .inspection import (
    inspect as inspect,
)
from .interpolation import (
    Particles as Particles,
)
from .interpolation import (
    particles as particles,
)
from .measures import (
    Measure as Measure,
)
from .measures import (
    lift as lift,
)
from .morph import (
    morph as morph,
)
from .plan import (
    Plan as Plan,
)
from .plan import (
    transport_plan as transport_plan,
)
from .points import (
    WeightedPoints as WeightedPoints,
)
from .potentials import (
    Potentials as Potentials,
)
from .release import (
    __version__ as __version__,
)
from .result import (
    Morph as Morph,
)
from .sampling import (
    Barycentric as Barycentric,
)
from .sampling import (
    barycentric_plan as barycentric_plan,
)
from .sampling import (
    sample_plan as sample_plan,
)
from .sinkhorn import (
    sinkhorn as sinkhorn,
)

__all__ = [
    "__version__",
    "Archive",
    "Barycentric",
    "ClmorphError",
    "ClmorphWarning",
    "ConvergenceWarning",
    "DeviceError",
    "Displacement",
    "Divergence",
    "FileError",
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
    "PruningWarning",
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
