"""Measures of weighted points, which are made from images or arrays or by joining points."""
