"""
Births and deaths
=================

With a reach, mass that would travel too far dies where it is, and what the other picture has more
of is born there. The marginals of the plan say how much.
"""

import matplotlib.pyplot as plt
import numpy as np

import clmorph

y, x = np.mgrid[0:1:48j, 0:1:48j]


def spots(*places: tuple[float, float, float]) -> np.ndarray:
    """Return a density with bumps at places (x, y) of some height."""
    return sum(h * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 0.006) for u, v, h in places)


before = spots((0.25, 0.3, 1), (0.3, 0.75, 1))
after = spots((0.4, 0.35, 1), (0.85, 0.6, 1))
source, target = clmorph.density(before), clmorph.density(after)

fig, axes = plt.subplots(2, 3, figsize=(9, 6.2), layout="constrained")
for row, reach in zip(axes, (0.1, 0.5), strict=True):
    potentials = clmorph.sinkhorn(source, target, blur=0.03, reach=reach)
    plan = clmorph.transport_plan(source, target, potentials)
    leaving, arriving = plan.marginals
    dies, born = source.weights - leaving, target.weights - arriving
    ends, _ = plan.mean_destinations(source.points, target.points)
    start, way = 47 * source.points, 47 * (ends - source.points)
    heavy = (leaving > 0.1) & (start.round() % 3 == 0).all(axis=1)
    row[0].imshow(before - after, cmap="coolwarm", vmin=-1, vmax=1)
    row[0].quiver(*start[heavy].T, *way[heavy].T, angles="xy", scale_units="xy", scale=1)
    row[0].set_title(f"reach {reach}: {plan.total_mass / source.mass:.0%} moves")
    row[1].imshow(dies.reshape(48, 48), cmap="Reds", vmin=0, vmax=1)
    row[1].set_title(f"dies: {dies.sum() / source.mass:.0%}")
    row[2].imshow(born.reshape(48, 48), cmap="Greens", vmin=0, vmax=1)
    row[2].set_title(f"is born: {born.sum() / target.mass:.0%}")
    for ax in row:
        ax.axis("off")
