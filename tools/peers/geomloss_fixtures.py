"""Settings of GeomLoss's random tests: they draw the same problems always, and shrink none."""

from typing import Any

from hypothesis import HealthCheck, Phase, settings


def prepare(config: Any) -> None:
    """Set hypothesis's profile."""
    settings.register_profile(
        "peers", derandomize=True, database=None, deadline=None, print_blob=False,
        phases=(Phase.explicit, Phase.generate), suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    settings.load_profile("peers")
