"""Rearrange the pixels of one image so that they form another one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_integer, check_number
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.images.pixels import as_pixels, resized, split_alpha
from clmorph.measures.lift import lift
from clmorph.measures.measure import Measure
from clmorph.measures.options import LiftOptions
from clmorph.transport.assignment import Indices, assign, lower_bound
from clmorph.transport.barycentric import barycentric_plan
from clmorph.transport.potentials import Potentials
from clmorph.transport.sinkhorn import sinkhorn

#: Length scale of the entropic plan from which the search begins, and its tolerance.
BLUR, TOLERANCE = 0.015, 0.03


@dataclass(frozen=True, eq=False)
class Rearrangement:
    """The pixels of an image on their way to form another one.

    Attributes
    ----------
    image : (H, W, 3) array
        The image whose pixels move; floats in [0, 1].
    assignment : (H * W,) array
        The pixel, counted row by row, at which each pixel arrives. A permutation.
    cost : float
        Mean of |X_i - Y_s(i)|^2 / 2 over the pixels, in squared sides of the image.
    lower_bound : float
        No permutation has a lower cost.
    times : (n_frames,) array
        Times of the frames, from 0 to 1.
    """

    image: Array
    assignment: Indices
    cost: float
    lower_bound: float
    times: Array

    def __len__(self) -> int:
        return len(self.times)

    def frame(self, t: float) -> NDArray[np.float64]:
        """Draw the pixels at time t of their straight ways: (H, W, 3) array.

        The first and the last frame hold each pixel once. Between them, where several pixels meet
        one of them is seen, and an empty place shows the pixel nearest to it.
        """
        t = check_number("t", t, 0.0, 1.0)
        height, width, _ = self.image.shape
        starts = np.indices((height, width)).reshape(2, -1)
        ends = np.stack(np.divmod(self.assignment, width))
        rows, columns = np.rint((1 - t) * starts + t * ends).astype(np.intp)
        drawn = np.zeros((height, width, 3))
        empty = np.ones((height, width), bool)
        drawn[rows, columns] = self.image.reshape(-1, 3)
        empty[rows, columns] = False
        nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
        return drawn[tuple(nearest)]


def rearrange(
    a: ArrayLike,
    b: ArrayLike,
    *,
    n_frames: int = 30,
    color_weight: float = LiftOptions.color_weight,
    seconds: float = 10.0,
    seed: int = 0,
    backend: Backend = "auto",
) -> Rearrangement:
    """Move the pixels of A, each with its own color, so that they form B.

    Parameters
    ----------
    a, b : (H, W) or (H, W, 3) array_like
        Opaque images, see `clmorph.images.pixels.as_pixels`. B is resized to A's height and width.
    n_frames : int
        Number of frames, at least 2.
    color_weight : float
        See `clmorph.lift`.
    seconds : float
        Time after which the search for a cheaper permutation ends; the solver's time comes before
        it.
    seed : int
        Seed of the search.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Rearrangement

    Raises
    ------
    InputError
        If an argument cannot be used, or an image is not opaque.

    Examples
    --------
    >>> import numpy as np
    >>> a = np.array([[0.0, 0.2, 0.9, 1.0]])
    >>> found = rearrange(a, a[:, ::-1], n_frames=3, color_weight=10.0, backend="numpy")
    >>> found.assignment.tolist()
    [3, 2, 1, 0]
    >>> found.frame(1.0)[0, :, 0].tolist()
    [1.0, 0.9, 0.2, 0.0]
    """
    n_frames = check_integer("n_frames", n_frames, 2, 1 << 20)
    seconds = check_number("seconds", seconds, 0.0, 1e6)
    seed = check_integer("seed", seed, 0, (1 << 63) - 1)
    image, other = (_opaque(name, each) for name, each in (("a", a), ("b", b)))
    shape = (image.shape[0], image.shape[1])
    source, target = lift(image, color_weight), lift(resized(other, shape), color_weight)
    operations = get_backend(backend)
    potentials = sinkhorn(source, target, BLUR, tol=TOLERANCE, backend=operations)
    found = assign(
        source.points, target.points, seconds=seconds, seed=seed,
        destinations=_destinations(source, target, potentials, operations),
    )  # fmt: skip
    bound = lower_bound(source.points, target.points, potentials.g)
    return Rearrangement(image, *found, bound, np.linspace(0.0, 1.0, n_frames))


def _opaque(name: str, image: ArrayLike) -> Array:
    """Return an image as (H, W, 3) floats."""
    colors, alpha = split_alpha(as_pixels(image, name))
    if alpha is not None:
        raise InputError(f"{name} is not opaque: expected an image without transparent pixels")
    return colors


def _destinations(
    source: Measure, target: Measure, potentials: Potentials, operations: Backend
) -> Array:
    """Return the means of the plan in the lifted space: (N, 5) array."""
    means = barycentric_plan(source, target, potentials, backend=operations)
    return np.column_stack([means.positions, source.color_weight * means.colors])
