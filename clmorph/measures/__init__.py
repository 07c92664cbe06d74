"""Weighted points: from an image, from arrays, and taken together as coarser ones."""
