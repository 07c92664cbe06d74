"""The old name of `clmorph.analysis.channel_baseline`."""

import warnings

from clmorph.analysis.channel_baseline import *  # noqa: F403

warnings.warn(
    "clmorph.baseline has moved: import clmorph.analysis.channel_baseline",
    DeprecationWarning,
    stacklevel=2,
)
