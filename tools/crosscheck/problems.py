"""Random transport problems and options, each determined by a seed and its number alone."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import clmorph
from clmorph.measures.points import WeightedPoints
from crosscheck.exact import Dense, make_side
from crosscheck.numbers import NUMBER

#: Points a side of most problems, of some, and of few; at most so many pairs of the last.
SMALL, MIDDLE, LARGE, PAIRS = 60, 1500, 16384, 1 << 27
#: Shares of the larger ones.
MIDDLE_SHARE, LARGE_SHARE = 0.08, 0.01
#: Shares of what is meant to be refused: different masses without a reach, and a truncation that
#: is not below the tolerance.
REFUSED_MASSES, REFUSED_TRUNCATION = 0.02, 0.03
CLOUDS = ("random", "equal", "line", "repeated", "two far", "clusters", "picture", "offsets")
WEIGHTS = ("uniform", "random", "zeros", "tiny", "spread")

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Problem:
    """One call of `clmorph.sinkhorn`, what a line says of it, and why it is to be refused if so."""

    number: int
    source: Any
    target: Any
    blur: float
    reach: tuple[float | None, float | None]
    options: dict[str, Any] = field(repr=False)
    words: str
    refused: str = ""

    @property
    def pairs(self) -> int:
        """Pairs of points."""
        return len(parts(self.source)[0]) * len(parts(self.target)[0])

    def dense(self) -> Dense:
        """Return what is judged: the arrays that were given, epsilon = blur^2, rho = reach^2."""
        rho = [np.inf if reach is None else reach**2 for reach in self.reach]
        return Dense(
            make_side(*parts(self.source), rho[0]),
            make_side(*parts(self.target), rho[1]),
            NUMBER(self.blur**2),
        )


def parts(measure: Any) -> tuple[Array, Array, Array | None]:
    """Return weights, points and offsets."""
    if isinstance(measure, tuple):
        return measure[0], measure[1], None
    return measure.weights, measure.points, getattr(measure, "offsets", None)


def make(seed: int, number: int, grids: bool = False) -> Problem:
    """Return the problem of a number, between points or pictures, or between grids."""
    rng = np.random.default_rng([seed, number])
    if grids:
        return _between_grids(rng, number)
    size = rng.random()
    most = SMALL
    if size < MIDDLE_SHARE + LARGE_SHARE:
        most = LARGE if size < LARGE_SHARE else MIDDLE
    n, m = _sizes(rng, most)
    cloud = str(rng.choice(CLOUDS))
    # float32 numbers: their squares are exact in float64.
    blur = _log_uniform(rng, 0.003 if most == SMALL else 0.01, 1.0)
    reaches = [_log_uniform(rng, 0.01, 30.0) for _ in range(2)]
    kinds = ["one", "pair", "source", "target", "balanced"]
    kind = str(rng.choice(kinds, p=[0.3, 0.2, 0.1, 0.1, 0.3]))
    reach = {
        "one": (reaches[0], reaches[0]), "pair": (reaches[0], reaches[1]),
        "source": (None, reaches[1]), "target": (reaches[0], None), "balanced": (None, None),
    }[kind]  # fmt: skip
    source, target, told = _measures(rng, cloud, n, m, kind == "balanced")
    options, refused = _options(rng, most)
    if kind == "balanced" and rng.random() < REFUSED_MASSES / 0.3:
        weights, points, offsets = parts(source)
        source, refused = WeightedPoints(points, 1.5 * weights, offsets), "different masses"
    n, m = (len(parts(measure)[0]) for measure in (source, target))
    words = (
        f"{n} x {m} points in {parts(source)[1].shape[1]}D, {cloud}, {told}, blur {blur:.4g}, "
        f"reach {reach}, {options}"
    )
    return Problem(number, source, target, blur, reach, options, words, refused)


def _between_grids(rng: np.random.Generator, number: int) -> Problem:
    """Draw grids of 1 to 4 axes, with masks, steps of any size and any direction, and options."""
    kinds = [(True, True), (True, False), (False, True), (False, False)]
    balanced = kinds[rng.integers(4)]
    dimension, kind = int(rng.integers(1, 5)), str(rng.choice(WEIGHTS))
    most = round(SMALL ** (1 / dimension))
    shapes = rng.integers(1, most + 1, (2, dimension))
    shift = float(rng.choice([0.0, 100.0]))
    made = [_grid(rng, tuple(shape), kind, shift) for shape in shapes]
    if all(balanced):
        made = [grid.with_masses(grid.masses / grid.mass) for grid in made]
    if rng.random() < 0.2:
        made[1] = made[0]
    lengths = [None if fixed else _log_uniform(rng, 0.01, 30.0) for fixed in balanced]
    blur = _log_uniform(rng, 0.003, 1.0)
    options = {
        "tol": _log_uniform(rng, 1e-9, 1e-2),
        "max_iter": int(rng.integers(1, 400)),
        "precision": str(rng.choice(["auto", "float32"])),
    }
    words = (
        f"grids {made[0].shape} and {made[1].shape}, {kind} weights, blur {blur:.4g}, "
        f"reach {lengths}, {options}"
    )
    return Problem(number, made[0], made[1], blur, (lengths[0], lengths[1]), options, words)


def _grid(
    rng: np.random.Generator, shape: tuple[int, ...], kind: str, shift: float
) -> clmorph.Grid:
    count = int(np.prod(shape))
    mask = rng.random(shape) < rng.choice([0.6, 1.0])
    masses = _weights(rng, kind, count).reshape(shape)
    mask.flat[np.argmax(masses)] = True
    size = 10 ** rng.uniform(-1, 0.5)
    axes = []
    for n in shape:
        steps = rng.random(n) if rng.random() < 0.5 else np.full(n, rng.random())
        axis = shift + size * (rng.random() + np.cumsum(steps + 1e-3) / max(4, n))
        axes.append(axis[:: rng.choice([-1, 1])])
    return clmorph.grid_measure(np.where(mask, masses, np.nan), mask=mask, axes=axes)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.float32(np.exp(rng.uniform(np.log(low), np.log(high)))))


def _sizes(rng: np.random.Generator, most: int) -> tuple[int, int]:
    if most == SMALL:
        n, m = np.minimum(np.exp(rng.uniform(0, np.log(most + 1), 2)), most)
    elif most == MIDDLE:
        n, m = np.exp(rng.uniform(np.log(SMALL), np.log(most), 2))
    else:
        n = np.exp(rng.uniform(np.log(4096), np.log(most)))
        m = np.exp(rng.uniform(np.log(2048), np.log(min(most, PAIRS / n))))
        if rng.random() < 0.5:
            n, m = m, n
    return int(n), int(m)


def _options(rng: np.random.Generator, most: int) -> tuple[dict[str, Any], str]:
    """Draw the solver's options; and say whether they are meant to be refused."""
    tol = _log_uniform(rng, 1e-9 if most == SMALL else 1e-7, 1e-2)
    few = rng.random() < 0.3
    limit = {SMALL: 400, MIDDLE: 200, LARGE: 60}[most]
    options: dict[str, Any] = {
        "tol": tol,
        "max_iter": int(rng.integers(1, 31)) if few else limit,
        "precision": str(rng.choice(["auto", "float32"])),
        "multiscale": [True, False, "auto", "auto"][rng.integers(4)],
        "verify": bool(rng.random() < 0.3),
    }
    if most == SMALL and options["multiscale"] is True:
        # Each iteration over the points may take hundreds over cells, which are not counted.
        options["max_iter"] = min(50, options["max_iter"])
    way, refused = rng.random(), ""
    if way < REFUSED_TRUNCATION:
        options["truncation"] = float(max(tol, _log_uniform(rng, 1e-8, 0.1)))
        refused = "a truncation that is not below tol"
    elif way < 0.35:
        options["truncation"] = max(1e-9, tol * _log_uniform(rng, 0.01, 0.9))
        if options["truncation"] >= tol:
            options["truncation"] = None
    elif way < 0.6:
        options["truncation"] = None
    elif way < 0.75:
        options = {"tol": tol, "precision": options["precision"], "method": "geomloss"}
        options["scaling"] = float(rng.uniform(0.4, 0.9))
    return options, refused


def _measures(
    rng: np.random.Generator, cloud: str, n: int, m: int, balanced: bool
) -> tuple[Any, Any, str]:
    """Draw both measures, and say what their weights are."""
    if cloud == "picture":
        return _pictures(rng, n, m, balanced)
    if cloud == "equal":
        n = m = min(n, m)
    x, y = _clouds(rng, cloud, n, m)
    kind = str(rng.choice(WEIGHTS))
    if balanced and (kind == "tiny" or rng.random() < 0.3):
        a, b = _split(rng, _weights(rng, kind, min(n, m)), n, m)
        kind += " split"
    else:
        a, b = _weights(rng, kind, n), _weights(rng, kind, m)
        if balanced:
            a, b = a / a.sum(), b / b.sum()  # of one mass, up to the rounding of float64
    totals = _totals(rng, balanced)
    a, b = a * totals[0], b * totals[1]
    told = f"{kind} weights of {float(a.sum()):.3g} and {float(b.sum()):.3g}"
    if cloud == "offsets":
        # No pair costs less than nothing: that would create mass beyond float64.
        offsets = [rng.uniform(low, 0.5, len(z)) for low, z in ((-0.2, a), (0.2, b))]
        return WeightedPoints(x, a, offsets[0]), WeightedPoints(y, b, offsets[1]), told
    return (a, x), (b, y), told


def _clouds(rng: np.random.Generator, cloud: str, n: int, m: int) -> tuple[Array, Array]:
    d = int(rng.integers(1, 12))
    if cloud == "line":
        start, along = rng.random(d), rng.normal(size=d)
        along /= np.linalg.norm(along)
        x, y = (start + rng.random((count, 1)) * along for count in (n, m))
    elif cloud == "repeated":
        distinct = rng.random((int(rng.integers(1, 5)), d))
        x, y = (distinct[rng.integers(len(distinct), size=count)] for count in (n, m))
    elif cloud == "two far":
        middles = np.array([np.zeros(d), np.full(d, rng.uniform(1, 5) / np.sqrt(d))])
        x, y = (
            middles[rng.integers(2, size=count)] + 0.1 * rng.random((count, d)) for count in (n, m)
        )
    elif cloud == "clusters":
        middles, spread = rng.random((int(rng.integers(2, 12)), d)), 10 ** rng.uniform(-3, -1)
        x, y = (
            middles[rng.integers(len(middles), size=count)] + spread * rng.normal(size=(count, d))
            for count in (n, m)
        )
    else:
        x, y = rng.random((n, d)), rng.random((m, d))
        if cloud == "equal":
            y = x.copy()
    size, shift = 10 ** rng.uniform(-1, 0.5), rng.choice([0.0, 0.0, 0.0, 100.0])
    return size * x + shift, size * y + shift


def _weights(rng: np.random.Generator, kind: str, n: int) -> Array:
    if kind == "uniform":
        return np.full(n, 1.0 / n)
    if kind == "spread":
        return np.exp(rng.normal(0, 3, n)) / n
    weights = rng.integers(1, 1 << 20, n) / float(1 << 20)
    if kind == "zeros":
        weights[rng.random(n) < 0.4] = 0.0
    if kind == "tiny":
        weights[rng.random(n) < 0.5] *= 2.0**-100  # about 1e-30 beside 1
    if not weights.max() > 2.0**-30:
        weights[rng.integers(n)] = 0.5
    return weights


def _split(rng: np.random.Generator, weights: Array, n: int, m: int) -> tuple[Array, Array]:
    """Give two measures exactly the same mass: one has some weights of the other in halves."""
    pair = []
    for count in (n, m):
        parts_ = list(weights)
        while len(parts_) < count:
            place = int(rng.integers(len(parts_)))
            parts_[place] /= 2
            parts_.append(parts_[place])
        pair.append(rng.permutation(np.array(parts_)))
    return pair[0], pair[1]


def _totals(rng: np.random.Generator, balanced: bool) -> tuple[float, float]:
    """Draw by what both measures are multiplied: powers of 2, so that what was equal stays so."""
    way = rng.random()
    if way < 0.5:
        one = other = 0.0
    elif way < 0.8 or balanced:
        one = rng.uniform(np.log2(1e-15), np.log2(1e20))
        other = one + rng.uniform(-7, 7)
    else:
        one, other = rng.uniform(np.log2(1e-15), np.log2(1e20), 2)
    return 2.0 ** round(one), 2.0 ** round(one if balanced else other)


def _pictures(rng: np.random.Generator, n: int, m: int, balanced: bool) -> tuple[Any, Any, str]:
    """Draw two pictures, lifted."""
    color_weight = float(rng.choice([0.0, 0.5, 2.0, 3.0]))
    maps = not balanced and rng.random() < 0.4
    measures = []
    for count in (n, m):
        height = int(rng.integers(1, max(2, round(1.5 * np.sqrt(count)))))
        width = max(1, count // height)
        image = rng.random((height, width, 3))
        if rng.random() < 0.5:
            image = np.round(3 * image) / 3  # colors in common
        weights = rng.random((height, width)) if maps else None
        measures.append(clmorph.lift(image, color_weight, weights=weights))
    return measures[0], measures[1], "weights of a map" if maps else "uniform weights"
