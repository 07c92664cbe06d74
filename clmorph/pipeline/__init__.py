"""Two images in, a morph out: options, presets, the composition, its result."""
