"""The residual of potentials, by NumPy."""

import numpy as np

import clmorph
from clmorph.transport._solver.problem import Problem


def true_residual(pair, potentials):
    """The residual as `sinkhorn` defines it, by NumPy."""
    measures = [clmorph.WeightedPoints(np.asarray(x), np.asarray(w)) for w, x in pair]
    rho = potentials.rho if isinstance(potentials.rho, tuple) else (potentials.rho,) * 2
    problem = Problem.between(clmorph.get_backend("numpy"), *measures, rho)
    softmins = (
        problem.softmin(0, potentials.g, potentials.epsilon, True),
        problem.softmin(1, potentials.f, potentials.epsilon, True),
    )
    return problem.residual(potentials.f, potentials.g, *softmins, potentials.epsilon)
