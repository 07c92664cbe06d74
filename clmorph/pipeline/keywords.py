"""The types of options by name, for type checkers.

Written by ``tools/make_keywords.py`` from the option classes: change those.
"""

from collections.abc import Sequence
from typing import Literal, TypedDict


class MorphKeywords(TypedDict, total=False):
    """Options of `clmorph.morph` by name."""

    color_weight: float
    color_space: Literal["srgb", "linear", "lab", "luv", "oklab"]
    mass: Literal["uniform", "luminance", "alpha", "foreground"]
    extent: Literal["true", "unit"]
    landmarks: (
        Sequence[tuple[tuple[float, float], tuple[float, float]]]
        | Sequence[Sequence[tuple[tuple[float, float], tuple[float, float]]]]
        | Literal["auto"]
        | None
    )
    feature_weight: float | Sequence[float]
    blur: float | None
    reach: float | tuple[float | None, float | None] | None
    epsilon: float | None
    rho: float | tuple[float, float] | None
    tol: float
    max_iter: int
    size: int | None
    solve_size: int | None
    max_particles: int | None
    max_memory: float | None
    log_threshold: float | None
    barycentric: bool
    sample: int | None
    seed: int
    detail: Literal["layers", "cells", "pixels", "particles"]
    splatting: Literal["local", "adaptive", "fixed", "none"]
    sigma_start: float | Literal["auto"]
    sigma_end: float | Literal["auto"]
    gamma: float | None
    sigma: Literal["optimal"] | None
    endpoints: Literal["exact", "paper"]
    unmatched: Literal["fade", "grow", "drop"]
    path_space: Literal["srgb", "linear", "lab", "luv", "oklab"]
    n_frames: int
    fps: float | None
    duration: float | None
    hold: float
    ease: Literal["linear", "smooth", "in", "out"]
    loop: Literal["loop", "ping-pong", "once"]
    reverse: bool
    canvas: str | tuple[int, int]
    scaling: Literal["auto", "nearest", "smooth"]
    background: str | None
    lossless: bool


class RearrangeKeywords(TypedDict, total=False):
    """Options of `clmorph.rearrange` by name."""

    n_frames: int
    fps: float | None
    duration: float | None
    hold: float
    ease: Literal["linear", "smooth", "in", "out"]
    loop: Literal["loop", "ping-pong", "once"]
    reverse: bool
    canvas: str | tuple[int, int]
    scaling: Literal["auto", "nearest", "smooth"]
    background: str | None
    lossless: bool
    size: int | None
    color_weight: float
    color_space: Literal["srgb", "linear", "lab", "luv", "oklab"]
    extent: Literal["true", "unit"]
    gap: float
    seed: int


class RecolorKeywords(TypedDict, total=False):
    """Options of `clmorph.recolor` by name."""

    strength: float
    color_space: Literal["srgb", "linear", "lab", "luv", "oklab"]
    blur: float
    reach: float | None
    feather: float
    reference_frame: int | None
