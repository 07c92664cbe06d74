"""
What moves, how far, and what does not
======================================

`clmorph.inspect` solves the transport alone. Its picture shows where pixels go, the mass that dies
and is born, and the numbers.
"""

from skimage import data

import clmorph

cat = clmorph.fit(data.chelsea()[:, 85:385], 96)
astronaut = clmorph.fit(data.astronaut()[:256, 100:356], 96)
found = clmorph.inspect(astronaut, cat)
figure = found.plot()

# %%
# ``found.save("report.png")`` writes the picture. The numbers are attributes:

print("\n".join(found.lines()))
