"""Draw what the nodes for ComfyUI give: ``python tools/draw_nodes.py nodes.png`` (needs PyTorch).

Rows: Morph, Mix of three pictures by their weights, Rearrange, and Recolor of the first picture by
the second one with growing strength.
"""

import numpy as np
import torch
from draw_recolored import photograph
from drawing import parser

import clmorph
from clmorph.adapters.comfyui import NODE_CLASS_MAPPINGS

#: The photographs, the number of pictures in a row, and the weights of the photographs in mixes.
NAMES, COUNT = ("chelsea", "rocket", "coffee"), 5
WEIGHTS = ((2, 1, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1), (0, 1, 2))


def rows(device: str) -> list[torch.Tensor]:
    """Return an IMAGE of `COUNT` pictures for each node."""
    one, other, third = (torch.from_numpy(photograph(name)[None]).float() for name in NAMES)
    nodes = {name.removeprefix("Clmorph"): kind() for name, kind in NODE_CLASS_MAPPINGS.items()}
    film = {"source": one, "target": other, "frames": COUNT, "time": 0.5, "size": 0}
    morphed, _ = nodes["Morph"].run(ease="linear", preset="auto", device=device, **film)
    mixed = [
        nodes["Mix"].run(
            image_a=one, image_b=other, image_c=third, weight_a=weights[0], weight_b=weights[1],
            weight_c=weights[2], grid=0, preset="auto", size=0, device=device,
        )[0]
        for weights in WEIGHTS
    ]  # fmt: skip
    moved, _ = nodes["Rearrange"].run(color_weight=2.0, device=device, **film)
    colored = [
        nodes["Recolor"].run(
            one, other, strength=strength, color_space="oklab", blur=0.1, feather=0.0,
            device=device,
        )[0]
        for strength in np.linspace(0.0, 1.0, COUNT).tolist()
    ]  # fmt: skip
    return [morphed, torch.cat(mixed), moved, torch.cat(colored)]


def main() -> None:
    given = parser(__doc__).parse_args()
    drawn = [np.hstack(row.numpy()) for row in rows(given.device)]
    clmorph.write_image(given.output, np.vstack(drawn))


if __name__ == "__main__":
    main()
