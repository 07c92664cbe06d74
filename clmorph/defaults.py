"""Default values and presets: each stands here once.

Blur, reach, color weight and kernel widths are the paper's (section 4).
"""

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
#: Residual at which the solver stops, in units of epsilon.
TOL = 1e-3
#: Factor between the blurs of GeomLoss's schedule; the paper's.
SCALING = 0.9
#: Iterations after which the solver gives up (one = both updates).
MAX_ITER = 2000
#: A pair is kept from this share of its row's or its column's largest on.
PLAN_RELATIVE = 1e-4
#: The most that the pairs of a plan may take, in bytes.
MAX_PLAN_BYTES = 4 * 2.0**30
#: Named sets of options of ``clmorph morph``. "photo" (the default) looks well on arbitrary
#: pictures: sharp ends, no holes, no mud, and colors that rather change than fade. "paper" is
#: section 4 of the paper, with its axes (each stretched to [0, 1]), its particles (nothing drawn
#: for unmatched mass) and its blurred ends. `size` is the longer side, in pixels, to which
#: images are reduced.
PRESETS: dict[str, dict[str, float | int | str | None]] = {
    "photo": {
        "size": 128,
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
    },
    "paper": {
        "size": 48,
        "blur": BLUR,
        "reach": REACH,
        "color_weight": COLOR_WEIGHT,
        "sigma_start": SIGMA_START,
        "sigma_end": SIGMA_END,
        "gamma": GAMMA,
        "splatting": "adaptive",
        "endpoints": "paper",
        "path_space": "srgb",
        "extent": "unit",
        "unmatched": "drop",
    },
}
