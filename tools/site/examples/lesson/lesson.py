"""
Optimal transport in one lesson
===============================

A notebook for teaching, from piles of sand to a film. It takes less than two minutes on a laptop
without a graphics card. Download it as a notebook at the end of the page; each part ends with a
question.
"""

# %%
# 1. Piles of sand
# ----------------
#
# Two piles on a line. A *plan* says how much sand goes from each place to each place. It is a
# matrix whose rows sum to the first pile, and whose columns sum to the second.

import matplotlib.pyplot as plt
import numpy as np

import clmorph

x = np.linspace(0, 1, 60)
a = np.exp(-(((x - 0.25) / 0.08) ** 2))
b = np.exp(-(((x - 0.7) / 0.12) ** 2))
a, b = a / a.sum(), b / b.sum()


def plan_of(blur, reach=None):
    """Return the plan between both piles as a matrix."""
    potentials = clmorph.sinkhorn((a, x), (b, x), blur=blur, reach=reach)
    return clmorph.transport_plan((a, x), (b, x), potentials).to_scipy().toarray()


plan = plan_of(blur=0.02)
fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
left.fill_between(x, a, alpha=0.6, label="before")
left.fill_between(x, b, alpha=0.6, label="after")
left.legend()
right.imshow(plan, cmap="Blues", extent=(0, 1, 1, 0))
right.set(xlabel="to", ylabel="from", title="the plan")
print("rows sum to a:", np.allclose(plan.sum(axis=1), a, atol=1e-4))

# %%
# *Question.* The cheapest plan between two piles on a line never crosses. How is that seen in the
# matrix?

# %%
# 2. Blur
# -------
#
# The solver adds an entropy, which spreads the plan over the length ``blur`` and makes the problem
# smooth.

fig, axes = plt.subplots(1, 4, figsize=(10, 2.8), layout="constrained")
for ax, blur in zip(axes, (0.01, 0.05, 0.15, 0.5), strict=True):
    ax.imshow(plan_of(blur), cmap="Blues", extent=(0, 1, 1, 0))
    ax.set_title(f"blur {blur}")

# %%
# *Question.* What does the plan become for a very large blur, and why is a ⊗ b the answer?

# %%
# 3. Sinkhorn's iteration
# -----------------------
#
# Two potentials determine the plan. Each half-step fixes one side; the residual says how far they
# are from agreeing.

solved = clmorph.sinkhorn((a, x), (b, x), blur=0.02, tol=1e-6)
plt.figure(figsize=(7, 3), layout="constrained")
plt.semilogy(solved.residuals, ".-")
plt.xlabel("iteration")
plt.ylabel("residual, in ε")
print(solved.message)

# %%
# *Question.* Halve the blur: how many more iterations does it take?

# %%
# 4. When masses differ
# ---------------------
#
# With a ``reach`` sand may vanish and appear, at a price. What would travel much farther than the
# reach rather does that.

fig, axes = plt.subplots(1, 3, figsize=(10, 2.8), layout="constrained", sharey=True)
for ax, reach in zip(axes, (0.1, 0.3, 1.0), strict=True):
    plan = plan_of(0.02, reach)
    ax.plot(x, a, "C0:")
    ax.plot(x, b, "C1:")
    ax.fill_between(x, plan.sum(axis=1), color="C0", alpha=0.5)
    ax.fill_between(x, plan.sum(axis=0), color="C1", alpha=0.5)
    ax.set_title(f"reach {reach}: {plan.sum():.0%} moves")

# %%
# *Question.* Why does sand at the near flanks move first when the reach grows?

# %%
# 5. A film
# ---------
#
# A picture is sand of many colors: each pixel is a point with a place and a color. A film shows the
# sand on its way.

from skimage import data

cat = clmorph.fit(data.chelsea()[:, 85:385], 64)
coffee = clmorph.fit(data.coffee()[:, 100:500], 64)
film = clmorph.morph(cat, coffee, n_frames=12)
fig, axes = plt.subplots(1, 5, figsize=(10, 2.3), layout="constrained")
for ax, t in zip(axes, (0, 0.25, 0.5, 0.75, 1), strict=True):
    ax.imshow(film.frame(t))
    ax.set_title(f"t = {t}")
    ax.axis("off")

# %%

film

# %%
# *Question.* Give ``blur``, ``reach`` or ``color_weight`` to `clmorph.morph`, and say what changes
# before you look.
