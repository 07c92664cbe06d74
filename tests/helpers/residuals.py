"""The residual of potentials, by NumPy, and how batches may differ from solves alone."""

import numpy as np

import clmorph
from clmorph.transport._solver.problem import Problem


def true_residual(pair, potentials):
    """The residual as `sinkhorn` defines it, by NumPy."""
    measures = [clmorph.WeightedPoints(np.asarray(x), np.asarray(w)) for w, x in pair]
    rho = potentials.rho if isinstance(potentials.rho, tuple) else (potentials.rho,) * 2
    problem = Problem.between(clmorph.get_backend("numpy"), *measures, rho)
    softmins = (
        problem.softmin_rows(potentials.g, potentials.epsilon, True),
        problem.softmin_columns(potentials.f, potentials.epsilon, True),
    )
    return problem.residual(potentials.f, potentials.g, *softmins, potentials.epsilon)


def iterates_itself(backend):
    """Return whether the arithmetic between softmins is the device's."""
    device = clmorph.get_backend(backend)
    return backend != "numpy" and device.has_float64 and not device.constants.longest_loop


def slack_of_count(backend, n_iter):
    """Return by how many iterations a batch may differ from a solve alone."""
    return 1 if iterates_itself(backend) else 1 + 0.1 * max(0, n_iter - 50)
