"""The old name of `clmorph.analysis.metrics`."""

import warnings

from clmorph.analysis.metrics import *  # noqa: F403

warnings.warn(
    "clmorph.quality has moved: import clmorph.analysis.metrics",
    DeprecationWarning,
    stacklevel=2,
)
