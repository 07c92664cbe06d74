"""Mixtures of several images: grids of mixes, and paths through them."""
