"""
A volume from NIfTI
===================

A scan is a grid of cells, with the spacing of its header and a mask of the cells that count. A
softmin sums along one axis after the other, so that 256³ cells fit in memory. The displacement
field is saved beside the scan.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import nibabel
import numpy as np

import clmorph

folder = Path(tempfile.mkdtemp())
spacing = (2.0, 2.0, 3.0)  # mm
x, y, z = np.meshgrid(
    *(s * np.arange(n) for s, n in zip(spacing, (32, 28, 16), strict=True)), indexing="ij"
)
for name, grown in (("first", 0.0), ("later", 3.0)):
    lesion = np.exp(-((x - 24 - grown) ** 2 + (y - 30) ** 2 + (z - 24) ** 2) / (8 + grown) ** 2)
    scan = nibabel.Nifti1Image((1000 * lesion).astype(np.float32), np.diag([*spacing, 1.0]))
    nibabel.save(scan, folder / f"{name}.nii.gz")

# %%
# The masses are read, with the spacing of the header. They differ: the lesion grows.

images = [nibabel.load(folder / f"{name}.nii.gz") for name in ("first", "later")]
brain = np.hypot((x - 31) / 31, (y - 27) / 27) < 1
first, later = (
    clmorph.grid_measure(image.get_fdata(), image.header.get_zooms()[:3], mask=brain)
    for image in images
)
solved = clmorph.sinkhorn(first, later, blur=3.0, reach=12.0)
moved = clmorph.displacement_field(first, later, solved)
print(first, later, solved, sep="\n")

# %%
# The field has the shape of the grid, and goes into a file with the same axes.

field = np.nan_to_num(moved.field).astype(np.float32)
nibabel.save(nibabel.Nifti1Image(field, images[0].affine), folder / "displacement.nii.gz")

fig, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
middle = np.s_[:, :, 8]
for ax, grid, title in zip(axes, (first, later), ("first", "later"), strict=False):
    ax.imshow(grid.array(grid.weights)[middle].T, cmap="magma", origin="lower")
    ax.set_title(title)
axes[2].imshow(first.masses[middle].T, cmap="magma", origin="lower")
ax = axes[2]
ax.quiver(*(each[::2, ::2, 8] / s for each, s in zip((x, y), spacing, strict=False)),
          field[::2, ::2, 8, 0], field[::2, ::2, 8, 1], color="w", scale=60)  # fmt: skip
ax.set_title("displacement, mm")
