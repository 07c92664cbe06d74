"""
A field from NetCDF
===================

An array of xarray brings the coordinates of its dimensions, in any steps, and cells without data
are left out by a mask. The barycenter of days with unlike masses stands between them.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray

import clmorph

file = Path(tempfile.mkdtemp()) / "rain.nc"
north, east = np.linspace(0.0, 400.0, 33), np.linspace(0.0, 600.0, 49)  # km
days = []
for day, amount in enumerate((1.0, 1.5)):
    away = (north[:, None] - 150 - 80 * day) ** 2 + (east - 180 - 220 * day) ** 2
    days.append(amount * np.exp(-0.5 * away / 50**2))
rain = np.array(days)
rain[:, :6, :8] = np.nan  # a mountain that the radar does not see
coords = {"day": [1, 2], "north": north, "east": east}
xarray.Dataset({"rain": (("day", "north", "east"), rain)}, coords).to_netcdf(file, engine="scipy")

# %%
# The file is read; ``notnull()`` is the mask.

with xarray.open_dataset(file, engine="scipy") as dataset:
    grids = [
        clmorph.grid_measure(values, mask=values.notnull())
        for values in (dataset["rain"].sel(day=day).load() for day in (1, 2))
    ]
print(*grids, sep="\n")
between = clmorph.barycenter(grids, fixed=True, blur=20.0, reach=300.0, tol=0.01)
print(between)

fig, axes = plt.subplots(1, 3, figsize=(11, 2.8), layout="constrained")
titles = ("day 1", "between", "day 2")
for ax, grid, title in zip(axes, (grids[0], between.grid, grids[1]), titles, strict=True):
    ax.pcolormesh(east, north, grid.array(grid.weights), cmap="Blues")
    ax.set_title(f"{title}: {grid.mass:.0f}")
