"""The residual and the certificate of potentials, by NumPy."""

import clmorph
from clmorph.transport._solver.problem import Problem


def true_residual(pair, potentials):
    return true_errors(pair, potentials)[0]


def true_errors(pair, potentials):
    """The residual as `sinkhorn` defines it, and the certificate."""
    measures = clmorph.measures.points.as_pair(*pair)
    rho = potentials.rho if isinstance(potentials.rho, tuple) else (potentials.rho,) * 2
    problem = Problem.between(clmorph.get_backend("numpy"), *measures, rho)
    softmins = (
        problem.softmin(0, potentials.g, potentials.epsilon, True),
        problem.softmin(1, potentials.f, potentials.epsilon, True),
    )
    given = potentials.f, potentials.g, *softmins, potentials.epsilon
    return problem.residual(*given), problem.certificate(*given)
