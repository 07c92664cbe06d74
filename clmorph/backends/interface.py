"""The few expensive operations that every backend implements, with these signatures.

All other mathematics of the package is written once and calls them, so a disagreement between two
backends can be traced to one operation.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.records import (
    Affine,
    Bins,
    Float32,
    Float64,
    LayerView,
    NearPairs,
    PlanRows,
    PlanTerms,
    ResidentIteration,
    StoredPairs,
    StoredVectors,
)

#: The largest number of points of a cloud: kernels count columns in float32, which is exact up to
#: this number.
MAX_POINTS = 1 << 24
#: The largest number of points of a batch of clouds (`Operations.upload_batch`).
MAX_BATCH = 1 << 18
#: Largest cost and largest rho, in units of epsilon: potentials are of their size, and beyond this
#: float64 leaves no digits for epsilon.
MAX_SPREAD = 1e12
#: The largest number of cells along an axis of a grid: a line is summed for each of its places.
MAX_AXIS = 4096
#: The largest dimension of points.
MAX_DIMENSION = 1024
#: The largest number of coordinates of lifted pictures: position, color, features and landmarks.
MAX_LIFTED = 11

#: The number of iterates that an accelerated iteration stores, the regularization of its
#: least-squares problem, relative to the diagonal, and the share of the remaining residual that is
#: added, as in over-relaxation.
MEMORY, RIDGE, MIXING = 16, 1e-10, 1.5
#: The largest argument of an exponential function: larger ones could overflow in products.
MAX_EXPONENT = 300.0

#: The largest error of a splat's kernel, as a share of the kernel's peak.
KERNEL_ERROR = 1e-6


class Operations(Protocol):
    """The operations of a backend, whose clouds, particles and splats are opaque handles.

    A cloud x_i with masses a_i is uploaded once and then represents the rows or the columns of a
    matrix. Rows are indexed by i (N of them), columns by j (M of them); C_ij = |X_i - Y_j|^2 / 2 is
    the cost of a pair, f and g are dual potentials, and

        pi_ij = a_i b_j exp((f_i + g_j - C_ij) / epsilon)

    is the transport plan (Eq. 2 of the paper).
    """

    #: The name of the device, its platform and its driver, as reports show it.
    description: str
    #: Side of a bin in pixels.
    bin_size: int
    #: Relative errors of one rounding: in a sum of exponentials, in an exponent, and in a
    #: precise exponent. See `clmorph.backends.rounding.rounding_error`.
    sum_roundoff: float
    exponent_roundoff: float
    precise_roundoff: float
    #: Whether the device computes in float64. Precise exponents are pairs of float32 where it does
    #: not, or more slowly.
    has_float64: bool
    #: Largest cost of a pair of points, in units of epsilon, at which softmins keep their bounds.
    max_spread: float
    #: Bytes of memory on the device; None if the backend works in the host's memory and has no
    #: limit of its own.
    memory_bytes: int | None
    #: Whether the device's memory is a part of the host's memory, as with CPUs.
    shares_host_memory: bool
    #: Whether the device is the host's processor itself.
    on_processor: bool
    #: Point pairs per second of the log-sum-exp in the device's trial; 0 if unknown.
    pairs_per_second: float

    def upload(self, points: Float64, weights: Float64, offsets: Float64 | None = None) -> Any:
        """Upload a cloud: (N, D) points and (N,) masses, which are at least 0 and not all 0.

        Costs are in the unit of the points squared. The `offsets` r, an (N,) array in cost units,
        add to the cost of every pair with a point: C_ij = |X_i - Y_j|^2 / 2 + r_i + s_j. With them,
        any cost that is a sum of products of features of the two points can be expressed.
        """

    def softmin(
        self,
        rows: Any,
        columns: Any,
        potential: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return the soft minimum of cost minus potential, T(g): (N,) array, cost units.

        It is -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon), with C_ij = |X_i - Y_j|^2 / 2
        (section 3.1 of the paper), summed over the pairs of `near` alone if these are given.
        Between batches of clouds it is that of each problem, one after the other.
        Precise exponents are formed in more than float32, at about half the speed.
        """

    def bounded_softmin(
        self,
        rows: Any,
        columns: Any,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
        enough: float = 0.0,
    ) -> tuple[Float64, Any]:
        """Return the soft minimum, and a proven bound of its rounding error.

        The bound is one of the sums' logarithms, in nats, and (B,) between batches. It is infinite
        where numbers are too large, and does not cover the pairs that `near` leaves out.
        Exponentials and sums are formed in float64, or in pairs of float32, which takes about three
        or nine times as long as `softmin`; float32 is used over near pairs where its error is
        proven to be at most `enough`, in nats.
        """

    def grid_log_sum_exp(
        self, exponents: Float64, axes: Sequence[tuple[Float64, Float64]], precise: bool = False
    ) -> Float64:
        """Return log sum_j exp(e_j - |x_i - y_j|^2) over the cells j of a grid, in nats.

        `exponents` e, an (m_1, ..., m_D) array, are -inf in empty cells, and not in all. `axes` are
        coordinates of places, (n_k,), and of cells, (m_k,), along each axis; those of cells ascend
        or descend. The result is an (n_1, ..., n_D) array. Sums are float32, or `precise` float64.
        """

    def start_iteration(
        self,
        rows: Any,
        columns: Any,
        weights: tuple[Float64, Float64],
        inverse_rho: tuple[float, float],
        corrections: tuple[Float64 | float, Float64 | float] = (0.0, 0.0),
    ) -> ResidentIteration | None:
        """Return an iteration whose vectors stay on the device; None where there is none.

        Rows and columns are clouds, or batches of them, whose problems then have one each.
        `weights` are the masses asked for of both clouds, whose softmins keep those of `upload`;
        `inverse_rho` the inverses of the marginal penalties, 0 if balanced; and `corrections` what
        is added to T(g), (N,), and to T(f), (M,), in cost units.
        """

    def upload_batch(
        self,
        points: Float64,
        weights: Float64,
        counts: NDArray[np.int64],
        offsets: Float64 | None = None,
    ) -> Any:
        """Upload the clouds of many problems, one after the other, as `upload` does.

        `counts`, a (B,) array, are the clouds' numbers of points, each at least 1 and in all at
        most `MAX_BATCH`.
        """

    def take_batch(self, batch: Any, problems: NDArray[np.int64]) -> Any:
        """Return a batch of some clouds of a batch, in the order of their numbers `problems`."""

    def near_pairs(
        self,
        rows: Any,
        columns: Any,
        potential: Float64,
        softmin: Float64,
        epsilon: float,
        budget: float,
    ) -> NearPairs:
        """Find the pairs that contribute to the rows' sums, and bound the share of all others.

        At most the share `budget` of a row's sum is left out. `softmin` is T(potential), or an
        estimate of it: a better estimate leaves fewer pairs, and brings `skipped` closer to the
        budget; the bound holds for any estimate.
        """

    def row_maxima(
        self,
        rows: Any,
        columns: Any,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j]: (N,) array, in nats."""

    def count_plan_rows(self, plan: PlanTerms, precise: bool = False) -> NDArray[np.int64]:
        """Return how many pairs of each row `plan_rows` keeps: (N,) array; arguments as there."""

    def plan_rows(
        self, plan: PlanTerms, precise: bool = False, counts: NDArray[np.int64] | None = None
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold, without a dense plan.

        log pi_ij = (f_i + g_j - C_ij) / epsilon + log a_i + log b_j is kept when it exceeds the
        smaller of `row_thresholds[i]` and `column_thresholds[j]`, in nats: +inf keeps no pair for
        this row or column, -inf all. `counts`, the result of `count_plan_rows` for the same
        arguments, avoids a second count.
        """

    def store_pairs(
        self,
        plan: PlanTerms,
        max_pairs: int,
        near: tuple[NearPairs | None, NearPairs | None] = (None, None),
    ) -> StoredPairs | None:
        """Store log pi_ij of the pairs above a threshold, as in `plan_rows`, on the device.

        `sum_stored` and `start_stored_iteration` use them. Pairs in neither of the lists `near`, of
        the rows and of the columns, may be left out although they are above a threshold. The result
        is None if there are more than `max_pairs` pairs, or more than the device can hold.
        """

    def sum_stored(
        self, stored: StoredPairs, changes: Float64, by_column: bool, ordered: bool = False
    ) -> Float64:
        """Return log sum_j pi_ij exp(changes_j) over each row's stored pairs: (N,) array, nats.

        The rows' sums have this value after g_j has grown by epsilon changes_j; it is -inf where no
        pair is stored. `by_column` sums over the rows of each column instead: changes are then
        (N,), and the result is (M,). `ordered` changes and sums have the order of
        `StoredPairs.orders`, which can take less time.
        """

    def start_stored_iteration(
        self,
        stored: StoredPairs,
        vectors: tuple[StoredVectors, StoredVectors],
        center: Float64,
        inverse_rho: tuple[float, float],
        over: Any = None,
    ) -> ResidentIteration | None:
        """Return an iteration over stored pairs whose vectors stay on the device.

        The result is None where the backend has no such iteration, or too little memory for it. The
        potentials and all other vectors have the order of `StoredPairs.orders`. Masses and duals
        come from their closed forms (`Problem.dual`). `center`, an (N,) array in cost units, is the
        center of the trust region of f; `over` is an iteration over the same pairs that is no
        longer used: its memory is used again.
        """

    def barycentric_projection(
        self,
        rows: Any,
        columns: Any,
        g: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> tuple[Float64, Float64]:
        """Return T(g), (N,), as `softmin` does, and the mean of each row's destinations, (N, D).

        Row i is sent to Y_j with the share pi_ij / (pi 1)_i, which depends on g alone. The mean is
        rounded relative to the spread of the destinations around the row's point.
        """

    def plan_moments(
        self,
        rows: Any,
        columns: Any,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> tuple[Float64, Float64]:
        """Return mean and covariance of each row's destinations: (N, D) and (N, D, D) arrays.

        Row i is sent to Y_j with the share pi_ij / (pi 1)_i, which depends on g alone, over the
        whole plan. `softmin` is T(g), by the operation of that name with the same `precise` and
        `near`.
        """

    def sample_plan_rows(
        self,
        rows: Any,
        columns: Any,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        thresholds: Float64,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> NDArray[np.int32]:
        """Return columns drawn from each plan row, pi_ij / (pi 1)_i: (N, k) array.

        Draw s of row i is the first column, in an order of the backend's own, up to which the
        shares add to more than thresholds[i, s]; so uniform thresholds draw without bias. They are
        within [0, 1), and ascend in each row. All else is as in `plan_moments`.
        """

    def upload_particles(self, table: Float64, links: NDArray[np.uint32], weights: Float64) -> Any:
        """Upload particles that move in straight lines.

        `table`, (P, 6), has positions in the common frame and colors of the points between which
        particles travel, and the spacing of points there, in units of that frame. `links`, (K, 2),
        are the rows of `table` where each particle starts and ends, and `weights`, (K, 2), its
        masses at t = 0 and t = 1.
        """

    def advect(
        self, particles: Any, t: float, scale: tuple[float, float], center: tuple[float, float]
    ) -> Any:
        """Return the splats of particles at time t, from 0 to 1, in pixel coordinates of a canvas.

        A particle at z in the common frame is drawn at (z - 1/2) * scale + center, both (x, y) in
        pixels.
        """

    def edge_preserving_mean(
        self,
        values: Float32,
        weights: Float32,
        guide: Float32,
        fine_guide: Float32,
        sigma: float,
        tolerance: float,
    ) -> Float64:
        """Average values over neighbors of like color (a joint bilateral filter): (H, W, C) array.

        A point p of a grid over the same extent takes the mean over cells q with the weights

            weights(q) exp(-|p - q|^2 / (2 sigma^2)) (like + 1e-9),
            like = exp(-|G(p) - g(q)|^2 / (2 tolerance^2)),

        where |p - q| and sigma are in cells, and q is at most ceil(2 sigma) rows and columns from
        the cell nearest to p. Where the weights, which are at least 0, add up to less than 1e-30
        the mean is near 0. Cells have `values` (h, w, C), `weights` (h, w) and colors g in `guide`
        (h, w, G), and points have colors G in `fine_guide` (H, W, G), with at most 8 channels each;
        `guide` itself as `fine_guide` smooths over cells. The tolerance is in units of the guide.
        """

    def follow_paths(
        self, field: Float32, to_field: Affine, shape: tuple[int, int], steps: int, rounds: int
    ) -> Float32:
        """Follow the place that each point of a grid shows, while a field moves it.

        At time t a point that stands at z on the field's grid shows what was at x = z - t v(x).
        From x = z at t = 0, each of `steps` to the next time takes `rounds` of

            x <- x - (x + t v(x) - z) / (1 + t s(x)),

        where s is at least the norm of the slope of v (`with_steepness`), so that rounds converge
        where the motion does not fold, also where it magnifies; and a point stays with its branch
        until that ends. The field v, (h, w, 2), is in points of its grid (row, column), linear in
        between and constant outside, and so is s. `to_field` leads from points of the other grid,
        of `shape` (H, W), to points of the field. The result, (steps + 1, H, W, 2), is x - z at the
        times 0, 1 / steps, ..., 1.
        """

    def upload_spline(self, coefficients: NDArray[np.float32]) -> Any:
        """Upload a picture, as the coefficients of a cubic spline: (H, W, 4) array.

        They are those of `scipy.ndimage.spline_filter` with the mode "mirror". Beyond the
        centers of its outermost pixels the picture is constant.
        """

    def upload_layer(self, paths: Float32, change: Float32) -> Any:
        """Upload what moves and recolors a picture.

        `paths`, (S + 1, H, W, 2) with S >= 1, is what `follow_paths` has returned; `change`, (h, w,
        8), is the change of color on the grid of the field, and what the picture shows there (its
        guide): a pixel takes the change of the points around it whose guide is like its own color.
        """

    def draw_layers(
        self,
        views: Sequence[LayerView],
        low: Float32,
        shape: tuple[int, int],
        rows: slice | None = None,
    ) -> Float32:
        """Draw two layers over one another: the sum of both, each times its weight, plus `low`.

        The result has `shape` (height, width) and 4 channels, or some `rows` of it, (start, stop);
        `low`, (h, w, 4), is on a grid over the extent of the canvas, and linear in between. Between
        stored times and between grid points paths are linear. Where neighbors take their colors
        from places more than `records.TEAR` times as far apart as pixels, a pixel is, by and by,
        the binomial mean over 3 x 3 pixels: a tear has no steps.
        """

    def upload_splats(
        self, positions: Float32, colors: Float32, weights: Float32, spacings: Float32 | None = None
    ) -> Any:
        """Upload particles at rest: (K, 2) positions in pixels, (K, 3) colors, (K,) masses.

        `spacings`, (K,), are the distances between neighboring particles around each one, in
        pixels; 1 if not given.
        """

    def deposit(self, splats: Any, shape: tuple[int, int]) -> tuple[Float64, Float64]:
        """Give each splat to its nearest pixel, and return sums of masses and of their squares.

        Both are (height, width) arrays; the splats have no individual widths.
        """

    def adapt_widths(self, splats: Any, distances: Float64, sigma: float) -> Any:
        """Give every splat an individual width, by Eq. 3 with the distance between its neighbors.

        The width is max(sigma * spacing, distance / 2), rounded to one of the
        `records.WIDTH_LEVELS` around sigma. `distances`, (height, width), are those between
        neighboring particles around each pixel of the canvas, in pixels, and are interpolated
        bilinearly; outside the canvas, the distance at the border counts. `sigma` is the kernel
        width in units of the spacing, and `splat` is to be called with the same. Weights are scaled
        so that the sum of each kernel over the canvas is that of a kernel of width sigma.
        """

    def width_levels(self, splats: Any) -> NDArray[np.int64]:
        """Return the width level of each splat: (K,) array, the base level by default."""

    def bin_splats(self, splats: Any, shape: tuple[int, int], margin: int) -> Bins:
        """Sort splats into the bins of a canvas of `shape` (height, width), in pixels.

        `margin` bins are added on every side; splats farther out fall into the outermost ones.
        """

    def splat(
        self, splats: Any, shape: tuple[int, int], sigma: float, radius: float
    ) -> tuple[Float64, Float64]:
        """Return the two sums of a Nadaraya-Watson frame (paper, section 3.3).

        They are the numerator sum_k w_k K(p - p_k) c_k, (height, width, 3), and the denominator
        sum_k w_k K(p - p_k), (height, width). `sigma` is the kernel width in pixels; with 0, each
        splat is given to its nearest pixel. Splats with individual widths use them in its place,
        and `radius` is then scaled by the ratio of the two widths.

        A kernel counts where |dx| and |dy| are at most `radius`, in pixels; it does not count where
        one of them is larger than `radius` plus a kernel width (`sigma`, or the splat's own). A
        backend may or may not count it in between. The kernel's error is at most `KERNEL_ERROR` of
        its peak, and 0 for a width of 0.
        """

    def nearest_seeds(self, seeds: Float32, shape: tuple[int, int]) -> NDArray[np.int32]:
        """Return the nearest seed of each pixel, which is the Voronoi cell that it is in.

        The index of the seed in a (height, width) array minimizes (x - x_k)^2 + (y - y_k)^2. A
        backend may round the four operations to float32; it takes the lowest index of the seeds
        that are equally near then, as seeds in the same place always are. There is at least one
        seed; `seeds`, (K, 2), are positions (x, y) in pixels, inside the canvas or outside of it,
        finite and at most 1e18.
        """

    def upload_table(self, table: Float32) -> Any:
        """Upload a table of colors over the cube [0, 1]^3: (n, n, n, 3) array, 2 <= n <= 256."""

    def apply_table(self, table: Any, colors: Float32) -> Float32:
        """Return colors after a table: (N, 3) array, N >= 1.

        Colors, (N, 3), are finite, and those outside of the cube are taken to its border. Between
        nodes the interpolation is tetrahedral: a color is the mean of the corners of the cell that
        lie on the way from its lowest to its highest corner along the axes in the order of the
        color's coordinates in the cell, from the largest one to the smallest.
        """
