"""Odd calls with the values of ``tests/helpers/api_values.py``, judged by its rules."""

import os
import runpy
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from clmorph import ConvergenceWarning
from clmorph.backends.opencl.devices.find import find_devices

SOURCE = Path(__file__).parents[2] / "tests" / "helpers" / "api_values.py"


class Target:
    """Cases of this kind, whose calls may leave files in a folder."""

    def __init__(self, folder: Path) -> None:
        if not SOURCE.exists():
            raise FileNotFoundError(f"{SOURCE} is not there: it holds the calls to try")
        self.values = runpy.run_path(str(SOURCE))
        warnings.simplefilter("ignore", ConvergenceWarning)
        # Before anything is limited or compared: drivers take address space, and pyopencl sets a
        # variable of the environment when it is imported.
        find_devices()
        os.chdir(folder)
        self.values["furnish"]()

    def case(self, rng: np.random.Generator) -> tuple[str, bytes, Callable[[], list[str]]]:
        """Return what is tried, the offending input if it offends, and what tries it."""
        description, call = next(self.values["calls"](rng))

        def run() -> list[str]:
            try:
                self.values["check"](description, call)
            except AssertionError as error:
                return [" ".join(str(error).split())]
            return []

        return description, description.encode(), run
