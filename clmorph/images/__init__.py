"""Input of images: reading, pixels, color spaces, and the resolution of an image."""
