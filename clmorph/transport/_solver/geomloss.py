"""The schedule of the GeomLoss library, with which its published results can be reproduced.

The blur falls from the diameter to the requested blur, with one averaged step at each blur; there
is no convergence test. Source: Feydy et al., "Interpolating between optimal transport and MMD using
Sinkhorn divergences" (2019), and the GeomLoss library.
"""

from collections.abc import Callable

import numpy as np

from clmorph._shared.typing import Array
from clmorph.transport._solver.problem import Problem


def blurs(diameter: float, blur: float, scaling: float) -> list[float]:
    """Return the schedule: the diameter twice, then blurs that fall by `scaling`, then `blur`."""
    if diameter <= 0.0:
        return [blur, blur]
    # The schedule is computed from logarithms of epsilon, as in GeomLoss, because one step more or
    # less would change the result.
    falling = np.arange(2 * np.log(diameter), 2 * np.log(blur), 2 * np.log(scaling))
    return [diameter, *np.exp(falling / 2), blur]


def run(
    problem: Problem, blur: float, scaling: float, precise: bool, report: Callable[[float], None]
) -> tuple[Array, Array, int]:
    """Return f and g after the schedule, and the number of its iterations."""
    schedule = blurs(float(np.sqrt(2 * problem.largest_cost)), blur, scaling)

    def both(f: Array, g: Array, epsilon: float) -> tuple[Array, Array]:
        source, target = problem.damping(epsilon)
        new_f = source * problem.softmin(0, g, epsilon, precise)
        return new_f, target * problem.softmin(1, f, epsilon, precise)

    f, g = np.zeros(len(problem.a)), np.zeros(len(problem.b))
    f, g = both(f, g, schedule[0] ** 2)
    for number, level in enumerate(schedule):
        new_f, new_g = both(f, g, level**2)
        f, g = 0.5 * (f + new_f), 0.5 * (g + new_g)
        report((number + 1) / len(schedule))
    return *both(f, g, blur**2), len(schedule) + 2
