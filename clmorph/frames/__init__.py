"""From a plan to frames: particles, kernel widths, splatting, exact ends."""
