"""Pictures in: pixels, color spaces, the resolution of a picture."""
