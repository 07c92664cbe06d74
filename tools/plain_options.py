"""Complete options for tools that set only some: the paper's, exact ends, images not reduced."""

from typing import Any

#: The paper's weight of color.
COLOR_WEIGHT = 2.0
PLAIN: dict[str, Any] = {
    "size": None,
    "solve_size": None,
    "max_particles": None,
    "blur": 0.05,
    "reach": 0.3,
    "color_weight": COLOR_WEIGHT,
    "sigma_start": 1.2,
    "sigma_end": 0.5,
    "splatting": "adaptive",
    "path_space": "srgb",
}
