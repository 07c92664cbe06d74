"""Why tests of other libraries say nothing about clmorph.

A test is declined in one of three ways: here, by its name, before it runs; by an adapter, where
it is asked for what clmorph does not do (`peers.bridge.Declined`); by the library itself, which
skips it. What fails, and is not here, is a failure.
"""

import re
from typing import NamedTuple


class Reason(NamedTuple):
    """A pattern of test names, and why such tests are not run or not counted."""

    pattern: str
    reason: str


#: About other problems altogether: these tests are not run.
OUTSIDE: dict[str, tuple[Reason, ...]] = {
    "pot": (
        Reason(r"barycenter|_bary_|unmix", "barycenters"),
        Reason(r"gromov", "Gromov-Wasserstein"),
        Reason(r"nystroem|lowrank", "low-rank plans"),
        Reason(r"screenkhorn", "screening of the dual, an approximation of its own"),
        Reason(r"_emd|solve_sample_methods|solve_sample_bsp", "no entropy, or Gaussians"),
        Reason(
            r"sample_NotImplemented.*'reg': 1, 'unbalanced'",
            "POT refuses what clmorph solves: see peers/pot_interface_cases.py",
        ),
        Reason(r"mm_wrong_divergence", "an unknown divergence is another library's choice"),
    ),
    "geomloss": (),
    "ott": (
        Reason(r"_lr_|low_rank|LRSinkhorn|lowrank", "low-rank plans"),
        Reason(r"barycenter", "barycenters"),
        Reason(r"gromov|gw_|fgw|quadratic", "Gromov-Wasserstein"),
    ),
}  # fmt: skip

#: About the library's own algorithm: such a test is run, and if it fails, that is no failure.
ALGORITHM: dict[str, tuple[Reason, ...]] = {"pot": (), "geomloss": (), "ott": ()}


def find(reasons: tuple[Reason, ...], test: str) -> str | None:
    """Return the first reason whose pattern is in a test's name, None if there is none."""
    for pattern, reason in reasons:
        if re.search(pattern, test):
            return reason
    return None
