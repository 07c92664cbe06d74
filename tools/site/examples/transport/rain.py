"""
How a forecast of rain is displaced
===================================

A forecast can have the right amount of rain in the wrong place. Pixel by pixel it is wrong twice;
the transport says by how much, and in which direction, it is displaced. Fields of xarray go in as
they are, with their coordinates; a mask leaves out what the radar does not see.
"""

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import clmorph

coordinates = {"lat": np.linspace(46, 50, 40), "lon": np.linspace(6, 12, 60)}


def rain(*cells: tuple[float, float, float, float]) -> xr.DataArray:
    """Return mm/h with cells (lon, lat, size, height)."""
    lon, lat = np.meshgrid(coordinates["lon"], coordinates["lat"])
    field = sum(h * np.exp(-((lon - u) ** 2 + (lat - v) ** 2) / s**2) for u, v, s, h in cells)
    return xr.DataArray(field, coordinates, ["lat", "lon"], attrs={"units": "mm/h"})


observed = rain((8, 47.5, 0.5, 6), (10, 48.8, 0.3, 4))
forecast = rain((8.8, 47.8, 0.5, 6), (10.7, 49.2, 0.3, 3))
seen = forecast.lat + forecast.lon > 54  # where the radar sees
source, target = (clmorph.grid_measure(field, mask=seen) for field in (forecast, observed))
# Blur and reach, and the displacements, are in the unit of the coordinates: degrees.
potentials = clmorph.sinkhorn(source, target, blur=0.12, reach=1.8)
moved = clmorph.displacement_field(source, target, potentials)
ways = moved.field[..., ::-1]  # lon, lat
wet = source.mask & (forecast.values > 0.5) & (np.indices(forecast.shape) % 3 == 0).all(axis=0)
lon, lat = np.meshgrid(coordinates["lon"], coordinates["lat"])
fig, ax = plt.subplots(figsize=(8, 4.2), layout="constrained")
forecast.where(seen).plot.imshow(ax=ax, cmap="Oranges", cbar_kwargs={"label": "forecast, mm/h"})
observed.where(seen).plot.contour(ax=ax, colors="C0", levels=[0.5, 2, 4])
ax.quiver(lon[wet], lat[wet], *ways[wet].T, angles="xy", scale_units="xy", scale=1, width=0.003)
ax.set_title("Where the forecast's rain should be; blue lines are what was observed")
shift = np.tensordot(moved.row_mass, ways, 2) / moved.transported_mass
print(f"displaced by {shift[0]:.2f} degrees of longitude and {shift[1]:.2f} of latitude")
print(f"rain that was not forecast anywhere near: {1 - moved.transported_mass / target.mass:.1%}")
