"""Conversion of image files to arrays, in bounded time and memory."""
