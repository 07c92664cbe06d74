"""Write ``tests/data/geomloss.npz``: the results of GeomLoss itself in float64.

Needs the extra ``bench`` (GeomLoss and torch), which the tests then do not: they compare
``clmorph.sinkhorn(method="geomloss")`` with this file.
"""

from pathlib import Path

import numpy as np
import torch
from geomloss import SamplesLoss

from clmorph.cli.demo import demo_images
from clmorph.images.pixels import fit
from clmorph.measures.lift import lift

BLUR = 0.05
REACHES = (None, 0.01, 0.05, 0.1, 0.3, 0.5)
SCALINGS = (0.9, 0.5)
FILE = Path(__file__).parents[1] / "tests" / "data" / "geomloss.npz"


def main() -> None:
    source, target = (
        lift(fit(image, side), 2.0) for image, side in zip(demo_images(), (8, 10), strict=True)
    )
    arrays = {"x": source.points, "y": target.points, "a": source.weights, "b": target.weights}
    tensors = [torch.from_numpy(arrays[name])[None] for name in "axby"]
    for reach in REACHES:
        for scaling in SCALINGS:
            loss = SamplesLoss(
                "sinkhorn", p=2, blur=BLUR, reach=reach, scaling=scaling, debias=False,
                potentials=True, backend="tensorized",
            )  # fmt: skip
            f, g = loss(*tensors)
            arrays[f"f reach {reach} scaling {scaling}"] = f.numpy().ravel()
            arrays[f"g reach {reach} scaling {scaling}"] = g.numpy().ravel()
    np.savez_compressed(FILE, **arrays)
    print(f"{FILE}: {FILE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
