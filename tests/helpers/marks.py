"""Parameters with marks."""

import pytest


def full(*values):
    """Return values of one parameter that are tested with --full only."""
    return [pytest.param(value, marks=pytest.mark.full) for value in values]
