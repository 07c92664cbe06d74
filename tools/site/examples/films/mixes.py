"""
Mixes of several pictures
=========================

`clmorph.mix` draws pictures between three or more others. The corners are the pictures themselves.
"""

import matplotlib.pyplot as plt
from skimage import data

import clmorph

pictures = [
    clmorph.fit(each, 64)
    for each in (data.chelsea()[:, 85:385], data.astronaut()[:256, 100:356],
                 data.coffee()[:, 100:500], data.rocket()[:, 100:527])
]  # fmt: skip
mixes = clmorph.mix(pictures, grid=4)

plt.figure(figsize=(6, 6), layout="constrained")
plt.imshow(mixes.sheet())
plt.axis("off")

# %%
# A film goes through mixes from stop to stop: ``mixes.save("tour.gif", "abdca")``.

mixes
