"""Random and degenerate clouds, and pictures."""

import numpy as np
from scipy.ndimage import gaussian_filter


def _cloud(rng, n, scale=(1, 1, 2, 2, 2), weights=None):
    points = rng.random((n, 5)) * scale
    return points, np.full(n, 1 / n) if weights is None else weights


def _image_cloud(rng, side):
    """A smooth picture, lifted."""
    y, x = np.meshgrid(*[np.linspace(0, 1, side)] * 2, indexing="ij")
    colors = [0.5 + 0.5 * np.sin(k * x + 3 * y + rng.random() * 6) for k in (2, 5, 7)]
    points = np.column_stack([x.ravel(), y.ravel()] + [2 * c.ravel() for c in colors])
    return points, np.full(side * side, side**-2.0)


def _zeroed(rng, n):
    weights = rng.random(n)
    weights[rng.random(n) < 0.4] = 0
    weights[0] = 1
    return weights


#: name -> function of a generator that returns two clouds (points, weights).
PAIRS = {
    "random": lambda rng: (_cloud(rng, 257), _cloud(rng, 403)),
    "images": lambda rng: (_image_cloud(rng, 24), _image_cloud(rng, 21)),
    "whole tiles": lambda rng: (_cloud(rng, 256), _cloud(rng, 128)),
    "one point each": lambda rng: (_cloud(rng, 1), _cloud(rng, 1)),
    "one and many": lambda rng: (_cloud(rng, 1), _cloud(rng, 130)),
    "many and one": lambda rng: (_cloud(rng, 130), _cloud(rng, 1)),
    "primes": lambda rng: (_cloud(rng, 61), _cloud(rng, 67)),
    "all equal": lambda rng: (
        (np.full((100, 5), 0.3), np.full(100, 0.01)),
        (np.full((70, 5), 0.3), np.full(70, 0.01)),
    ),
    "duplicates": lambda rng: tuple(
        (np.repeat(points[:20], 8, axis=0), np.full(160, 1 / 160))
        for points in (rng.random((20, 5)), rng.random((20, 5)))
    ),
    "zero weights": lambda rng: (
        _cloud(rng, 200, weights=_zeroed(rng, 200)),
        _cloud(rng, 300, weights=_zeroed(rng, 300)),
    ),
    "one mass among zeros": lambda rng: (
        _cloud(rng, 90),
        _cloud(rng, 200, weights=np.eye(200)[137]),
    ),
    "ten orders of mass": lambda rng: (
        _cloud(rng, 150, weights=10 ** rng.uniform(-10, 0, 150)),
        _cloud(rng, 220, weights=10 ** rng.uniform(-10, 0, 220)),
    ),
    "a line": lambda rng: (_cloud(rng, 99, scale=(1, 0, 0, 0, 0)), _cloud(rng, 140)),
    "two far clusters": lambda rng: (
        _cloud(rng, 130, scale=(0.01,) * 5),
        (rng.random((150, 5)) * 0.01 + 0.9, np.full(150, 1 / 150)),
    ),
}


def of_kind(kind, rng, n, m):
    """Two clouds (weights, points) of a kind, in 1 to 5 dimensions."""
    dimension = int(rng.integers(1, 6))
    x, y = rng.random((n, dimension)), rng.random((m, dimension))
    a, b = rng.random(n) + 0.01, rng.random(m) + 0.01
    if kind == "picture":
        t, u = np.linspace(0, 1, n), np.linspace(0, 1, m)
        x = np.column_stack((t, 0.5 + 0.4 * np.sin(9 * t), t**2))
        y = np.column_stack((u, 0.5 + 0.4 * np.cos(7 * u), 1 - u))
    if kind == "two far clusters":
        x = 0.1 * x + rng.integers(0, 2, (n, 1))
        y = 0.1 * y + rng.integers(0, 2, (m, 1))
    if kind == "many clusters":
        x = 0.02 * x + 0.2 * rng.integers(0, 5, x.shape)
        y = 0.02 * y + 0.2 * rng.integers(0, 5, y.shape)
    if kind == "one place and many":
        x[:] = x[0]
    if kind == "equal":
        x[:], y[:] = 0.4, 0.4
    if kind == "line":
        x[:, 1:], y[:, 1:] = 0, 0
    if kind == "duplicates":
        x, y = np.round(4 * x) / 4, np.round(4 * y) / 4
    if kind == "ten orders":
        a, b = 10 ** rng.uniform(-10, 0, n), 10 ** rng.uniform(-10, 0, m)
    return (a, x), (b, y)


def drawings(side):
    """Two pictures with edges and slopes, (side, side, 3) each."""
    y, x = np.mgrid[:side, :side] / side
    one = np.stack([x, 0.5 + 0.5 * np.sin(7 * y), (x + y > 0.9) * 0.8], axis=-1)
    two = np.stack([(x - 0.5) ** 2 + (y - 0.4) ** 2 < 0.1, y, 0.5 + 0.5 * np.cos(9 * x)], axis=-1)
    return one, two


def smooth(rng, shape, width=3):
    """A random smooth picture, from 0 to 1."""
    found = gaussian_filter(rng.random((*shape, 3)), (width, width, 0))
    return (found - found.min()) / np.ptp(found)
