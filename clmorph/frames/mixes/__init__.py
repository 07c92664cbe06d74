"""Frames that mix several images."""
