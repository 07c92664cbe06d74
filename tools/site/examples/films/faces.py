"""
A film of two faces
===================

Eyes become eyes if landmarks tell the transport which points belong together. With
``landmarks="auto"``, the default, clmorph looks for faces itself (the extra ``faces`` finds 108
points of each). Here eight pairs of points are given by hand, in pixels of both pictures.
"""

import matplotlib.pyplot as plt
from skimage import data

import clmorph

woman = data.astronaut()[55:175, 165:285]
cat = data.chelsea()[0:300, 60:360]
eyes_nose_mouth = [
    ((29, 44), (77, 105)), ((46, 47), (148, 136)), ((74, 49), (236, 152)), ((93, 49), (284, 114)),
    ((62, 70), (204, 243)), ((58, 91), (195, 268)), ((39, 86), (132, 273)), ((78, 87), (245, 273)),
]  # fmt: skip
plain = clmorph.morph(woman, cat, n_frames=10, size=128, landmarks=None)
film = clmorph.morph(woman, cat, n_frames=10, size=128, landmarks=eyes_nose_mouth)

fig, axes = plt.subplots(2, 5, figsize=(10, 4.3), layout="constrained")
for row, (name, each) in zip(axes, (("without", plain), ("with", film)), strict=True):
    for ax, t in zip(row, (0, 0.3, 0.5, 0.7, 1), strict=True):
        ax.imshow(each.frame(t))
        ax.set_title(f"{name} landmarks" if t == 0 else f"t = {t}", fontsize=10)
        ax.axis("off")

# %%
# With pictures of your own, faces are looked for in both of them::
#
#     pip install "clmorph[faces]"
#     clmorph morph a.png b.jpg -o film.gif
#
# In the player, ``m`` shows the landmarks. A click in each picture sets another pair.

film
