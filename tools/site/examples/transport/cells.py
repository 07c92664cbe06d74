"""
Single cells from AnnData
=========================

Cells are points of 30 principal components. The entropic map sends those of one day to where the
next day's are, and stores them beside the others.
"""

import anndata
import matplotlib.pyplot as plt
import numpy as np

import clmorph

rng = np.random.default_rng(0)
states = rng.normal(size=(3, 30)) * np.linspace(4, 0.2, 30)
drift = rng.normal(size=30) * np.linspace(1.5, 0.1, 30)


def day(shares: list[float], moved: float) -> anndata.AnnData:
    """Return a day's cells of three states."""
    state = rng.choice(3, 1500, p=shares)
    points = states[state] + moved * drift + 0.4 * rng.normal(size=(1500, 30))
    return anndata.AnnData(obs={"state": state.astype(str)}, obsm={"X_pca": points})


one, other = day([0.5, 0.3, 0.2], 0.0), day([0.3, 0.3, 0.4], 1.0)

# %%
# Some states grow, others shrink: with a reach masses of rows tell which.

solved = clmorph.sinkhorn(one.obsm["X_pca"], other.obsm["X_pca"], blur=1.0, reach=4.0)
one.obsm["X_later"] = solved.map(one.obsm["X_pca"])
one.obs["growth"] = solved.row_mass * one.n_obs
print(one)
print(one.obs.groupby("state")["growth"].mean())

fig, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", sharex=True, sharey=True)
axes[0].scatter(*other.obsm["X_pca"].T[:2], s=2, color="lightgray")
axes[0].scatter(*one.obsm["X_pca"].T[:2], s=2, c=one.obs["state"].astype(int), cmap="tab10")
axes[0].set_title("the first day, and the next one in gray")
axes[1].scatter(*other.obsm["X_pca"].T[:2], s=2, color="lightgray")
axes[1].scatter(*one.obsm["X_later"].T[:2], s=2, c=one.obs["growth"], cmap="coolwarm")
axes[1].set_title("where its cells go, by their growth")
