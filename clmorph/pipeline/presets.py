"""Default values and presets: each stands here once.

Blur, reach, color weight and kernel widths are the paper's (section 4).
"""

import math

#: Length scale of the entropic blur, in units of the longer image side; epsilon = blur^2.
BLUR = 0.05
#: Length scale of mass creation and destruction, same unit; rho = reach^2.
REACH = 0.3
#: Weight lambda of color distance (each channel in [0, 1]) against position.
COLOR_WEIGHT = 2.0
#: Kernel widths at t = 0 and t = 1, and the bulge between them, in canvas pixels (Eq. 4).
SIGMA_START = 1.2
SIGMA_END = 0.5
GAMMA = 0.5
#: Frames of a morph, both ends included.
N_FRAMES = 30
#: Frames a second, and seconds that the pictures themselves stay longer than a frame.
FPS = 20.0
HOLD = 0.65
#: Residual at which the solver stops, in units of epsilon.
TOL = 1e-3
#: Factor between the blurs of GeomLoss's schedule; the paper's.
SCALING = 0.9
#: Iterations after which the solver gives up (one = both updates).
MAX_ITER = 2000
#: A pair is kept from this share of its row's or its column's largest on.
PLAN_RELATIVE = 1e-4
#: The paper's threshold tau on log pi_ij, below which it leaves pairs out (section 3.1).
LOG_THRESHOLD = -13.0
#: The most that the pairs of a plan may take, in bytes.
MAX_PLAN_BYTES = 4 * 2.0**30
_PHOTO: dict[str, float | int | str | None] = {
    "size": 256,
    "solve_size": 128,
    "max_particles": 1_500_000,
    "blur": 0.03,
    "reach": 0.3,
    "color_weight": 0.5,
    "sigma_start": "auto",
    "sigma_end": "auto",
    "splatting": "local",
    "endpoints": "exact",
    "path_space": "oklab",
    "extent": "true",
    "unmatched": "fade",
}
#: Named sets of options of ``clmorph morph``; `size` is the longer side, in pixels, to which
#: pictures are reduced.
PRESETS: dict[str, dict[str, float | int | str | None]] = {
    # The default, for any pictures: sharp ends, no holes, no mud, colors that rather change than
    # fade; drawn finer than it is solved, by as many particles as make a frame a matter of
    # tenths of a second.
    "photo": _PHOTO,
    # Section 4 of the paper, with its axes (each stretched to [0, 1]), its particles (the pairs
    # above its threshold, nothing drawn for unmatched mass) and its blurred ends.
    "paper": {
        "size": 48,
        "blur": BLUR,
        "reach": REACH,
        "color_weight": COLOR_WEIGHT,
        "log_threshold": LOG_THRESHOLD,
        "sigma_start": SIGMA_START,
        "sigma_end": SIGMA_END,
        "gamma": GAMMA,
        "splatting": "adaptive",
        "endpoints": "paper",
        "path_space": "srgb",
        "extent": "unit",
        "unmatched": "drop",
    },
    # Sprites: pixels that stay pixels, and move with their colors.
    "pixel-art": _PHOTO
    | {
        "size": 64,
        "blur": 0.01,
        "color_weight": 1.0,
        "sigma_start": 0.3,
        "sigma_end": 0.3,
        "scaling": "nearest",
    },
    # Next to nothing moves: one picture fades out and the other in. To compare with.
    "crossfade": _PHOTO
    | {"reach": 0.001, "splatting": "fixed", "sigma_start": 0.3, "extent": "unit"},
    # Nothing fades: every pixel of one picture becomes some of the other's, however far.
    "balanced": _PHOTO | {"reach": math.inf},
}
