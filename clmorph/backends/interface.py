"""The few expensive operations that every backend implements.

`clmorph.backends.numpy.NumPyOperations` and `clmorph.backends.opencl.backend.OpenCLOperations` have
these methods with these signatures. All other mathematics of the package is written once and calls
these methods, so a disagreement between two backends can be traced to one operation.
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
    IterationNumbers,
    LayerView,
    NearPairs,
    PlanRows,
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
#: The largest dimension of points: a kernel keeps one register for each coordinate.
MAX_DIMENSION = 11

#: The number of iterates that an accelerated iteration stores, the regularization of its
#: least-squares problem, relative to the diagonal, and the share of the remaining residual that is
#: added, as in over-relaxation.
MEMORY, RIDGE, MIXING = 16, 1e-10, 1.5
#: The largest argument of an exponential function: larger ones could overflow in products.
MAX_EXPONENT = 300.0

#: The largest error of a splat's kernel, as a share of the kernel's peak.
KERNEL_ERROR = 1e-6


class ResidentIteration(Protocol):
    """Sinkhorn's iteration between two clouds, or over stored pairs, with vectors on the device.

    An iteration is a half-step of f and one of g, each with its shift, and an extrapolation of g:
    the formulas of `clmorph.transport._solver.half_steps`. The host reads a few numbers and
    decides which potential is the next.
    """

    def set_potential(self, g: Float64, epsilon: float, precise: bool) -> None:
        """Set the potential at which the next iteration begins.

        Parameters
        ----------
        g : (M,) array, cost units
        epsilon, precise
            As in `Operations.softmin`.
        """

    def iterate(self, begun: bool, place: int, count: int, radius: float) -> IterationNumbers:
        """Run one iteration, with one wait.

        Parameters
        ----------
        begun : bool
            Whether an iterate is stored, with which this one makes a difference.
        place : int
            The place of the difference, in 0 <= place < 16.
        count : int
            The number of differences that are then stored, at most 16.
        radius : float
            Radius of the trust region, see `clmorph.transport._solver.anderson`.
        """

    def go_on(self, extrapolated: bool) -> None:
        """Take the last iteration's extrapolation, or its image of g, as the next potential."""

    def go_back(self) -> None:
        """Drop the last iteration, and take the image of the one before as the next potential."""

    def potentials(self) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration: (N,), (M,), (M,) arrays."""


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
    #: Whether precise exponents are float64 (or better) and not pairs of float32.
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
    #: The name of the device's records in the cache: a digest of device, driver and kernels.
    record_key: str
    #: Point pairs per second of the log-sum-exp by a record of the device; 0 if there is none.
    pairs_per_second: float

    def upload(self, points: Float64, weights: Float64, offsets: Float64 | None = None) -> Any:
        """Upload a weighted cloud.

        Parameters
        ----------
        points : (N, D) array
            Coordinates in any unit; costs are in that unit squared.
        weights : (N,) array
            Masses, at least 0, of positive sum.
        offsets : (N,) array, optional
            Terms added to the cost of every pair with a point, in cost units:
            C_ij = |X_i - Y_j|^2 / 2 + r_i + s_j. With offsets, any cost that is a sum of
            products of features of the two points can be expressed.

        Returns
        -------
        cloud
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
        """Return the soft minimum of cost minus potential, T(g) of the paper's section 3.1.

        -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon), C_ij = |X_i - Y_j|^2 / 2.

        Parameters
        ----------
        rows, columns : clouds of N and M points
        potential : (M,) array, cost units
        epsilon : float, cost units
        precise : bool
            Whether exponents are formed in more than float32, at about half the speed.
        near : NearPairs, optional
            The only pairs that are summed; all pairs if not given.

        Returns
        -------
        (N,) array, cost units
        """

    def bounded_softmin(
        self,
        rows: Any,
        columns: Any,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
        enough: float = 0.0,
    ) -> tuple[Float64, float]:
        """Return the soft minimum with a proven bound of its rounding error.

        Exponentials and sums are formed in float64, or in pairs of float32. Bounds of a
        transport value are computed from such soft minima. The operation takes about three times
        as long as `softmin` on devices with float64, and about nine times as long on others.

        Parameters
        ----------
        rows, columns, potential, epsilon, near
            As in `softmin`.
        enough : float
            A rounding error, in nats, that need not be undercut: float32 is used over near pairs
            where its error is proven to be within it.

        Returns
        -------
        softmin : (N,) array, cost units
        error : float
            A bound of the rounding error of the sums' logarithms, in nats; infinite where
            numbers are too large for a bound. It does not cover the pairs that `near` leaves out.
        """

    def start_iteration(
        self,
        rows: Any,
        columns: Any,
        weights: tuple[Float64, Float64],
        inverse_rho: tuple[float, float],
    ) -> ResidentIteration | None:
        """Return an iteration whose vectors stay on the device; None where there is none.

        Parameters
        ----------
        rows, columns : clouds of N and M points
        weights : (N,) and (M,) arrays
            Their masses.
        inverse_rho : (float, float)
            Inverses of the marginal penalties; 0 is balanced.
        """

    def upload_batch(
        self,
        points: Float64,
        weights: Float64,
        counts: NDArray[np.int64],
        offsets: Float64 | None = None,
    ) -> Any:
        """Upload the clouds of many problems.

        Parameters
        ----------
        points, weights, offsets : (N, D), (N,) and (N,) arrays
            As in `upload`, the points of the clouds one after the other.
        counts : (B,) array
            Number of points of each cloud, at least 1. There are at most `MAX_BATCH` points.

        Returns
        -------
        batch
        """

    def take_batch(self, batch: Any, problems: NDArray[np.int64]) -> Any:
        """Return a batch of some clouds of a batch, in the order of their numbers `problems`."""

    def softmin_batch(
        self, rows: Any, columns: Any, potential: Float64, epsilon: float, precise: bool = False
    ) -> Float64:
        """Return the soft minima of many problems: `softmin` between the clouds of two batches.

        Cloud b of the rows is summed over cloud b of the columns, for all b at once.

        Parameters
        ----------
        rows, columns : batches of B clouds, of N and M points in all
        potential : (M,) array, cost units
        epsilon, precise
            As in `softmin`.

        Returns
        -------
        (N,) array, cost units
        """

    def bounded_softmin_batch(
        self, rows: Any, columns: Any, potential: Float64, epsilon: float
    ) -> tuple[Float64, Float64]:
        """Return the soft minima of many problems with proven bounds of their rounding errors.

        Parameters
        ----------
        rows, columns, potential, epsilon
            As in `softmin_batch`.

        Returns
        -------
        softmin : (N,) array, cost units
        errors : (B,) array
            As in `bounded_softmin`, a bound for each problem.
        """

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

        Parameters
        ----------
        rows, columns : clouds of N and M points
        potential : (M,) array, cost units
        softmin : (N,) array, cost units
            T(potential), or an estimate of it. A better estimate leaves fewer pairs, and brings
            `skipped` closer to the budget; the bound holds for any estimate.
        epsilon : float, cost units
        budget : float
            The share of a row's sum that may be left out.

        Returns
        -------
        NearPairs
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

    def count_plan_rows(
        self,
        rows: Any,
        columns: Any,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        precise: bool = False,
    ) -> NDArray[np.int64]:
        """Return how many pairs of each row `plan_rows` keeps: (N,) array.

        Parameters as there.
        """

    def plan_rows(
        self,
        rows: Any,
        columns: Any,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        precise: bool = False,
        counts: NDArray[np.int64] | None = None,
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold, without a dense plan.

        log pi_ij = (f_i + g_j - C_ij) / epsilon + log a_i + log b_j is kept when it
        exceeds the smaller of `row_thresholds[i]` and `column_thresholds[j]`.

        Parameters
        ----------
        rows, columns : clouds of N and M points
        f, g : (N,) and (M,) arrays, cost units
        epsilon : float, cost units
        row_thresholds, column_thresholds : (N,) and (M,) arrays, in nats
            With +inf no pair is kept for this row or column; with -inf all pairs are kept.
        precise : bool
            As in `softmin`.
        counts : (N,) array, optional
            The result of `count_plan_rows` for the same arguments, which avoids a second count.
        """

    def store_pairs(
        self,
        rows: Any,
        columns: Any,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        max_pairs: int,
        near: tuple[NearPairs | None, NearPairs | None] = (None, None),
    ) -> StoredPairs | None:
        """Store log pi_ij of the pairs above a threshold on the device.

        `sum_stored` and `start_stored_iteration` use them.

        Parameters
        ----------
        rows, columns, f, g, epsilon, row_thresholds, column_thresholds
            As in `plan_rows`.
        max_pairs : int
            The largest number of pairs that may be stored.
        near : (NearPairs of the rows, NearPairs of the columns), optional
            Lists of pairs. Pairs in none of them may be left out, although they are above a
            threshold.

        Returns
        -------
        StoredPairs or None
            None if there are more than `max_pairs` pairs, or more than the device can hold.
        """

    def sum_stored(
        self, stored: StoredPairs, changes: Float64, by_column: bool, ordered: bool = False
    ) -> Float64:
        """Return log sum_j pi_ij exp(changes_j) over the stored pairs of every row.

        The rows' sums have this value after g_j has grown by epsilon changes_j.

        Parameters
        ----------
        stored : StoredPairs
        changes : (M,) array, in nats
        by_column : bool
            Whether to sum over the rows of each column instead; `changes` is then an (N,) array.
        ordered : bool
            Whether changes and sums have the order of `StoredPairs.orders`, which can take less
            time.

        Returns
        -------
        (N,) array, or (M,), in nats
            -inf where no pair is stored.
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
        come from their closed forms (`Problem.dual`).

        Parameters
        ----------
        stored : StoredPairs
        vectors : (StoredVectors of the rows, StoredVectors of the columns)
        center : (N,) array, cost units
            The center of the trust region of f.
        inverse_rho : (float, float)
            As in `start_iteration`.
        over : ResidentIteration, optional
            An iteration over the same pairs that is no longer used: its memory is used again.
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
        """Return T(g) as `softmin` does, and the mean of each row's destinations, in one pass.

        Row i is sent to Y_j with the share pi_ij / (pi 1)_i, which depends on g alone.

        Parameters
        ----------
        rows, columns : clouds of N and M points in D dimensions
        g : (M,) array, cost units
        epsilon : float, cost units
        precise, near
            As in `softmin`.

        Returns
        -------
        softmin : (N,) array, cost units
        mean : (N, D) array
            It is rounded relative to the spread of the destinations around the row's point.
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
        """Return mean and covariance of each row's destinations, over the whole plan.

        Row i is sent to Y_j with the share pi_ij / (pi 1)_i, which depends on g alone.

        Parameters
        ----------
        rows, columns : clouds of N and M points in D dimensions
        g : (M,) array, cost units
        softmin : (N,) array, cost units
            T(g), by `softmin` with the same `precise` and `near`.
        epsilon : float, cost units
        precise, near
            As in `softmin`.

        Returns
        -------
        mean : (N, D) array
        covariance : (N, D, D) array
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

        Draw s of row i is the first column, in an order of the backend's own, up to which
        the shares add to more than thresholds[i, s]; so uniform thresholds draw without bias.

        Parameters
        ----------
        rows, columns, g, softmin, epsilon, precise, near
            As in `plan_moments`.
        thresholds : (N, k) array
            Within [0, 1), ascending in each row.
        """

    def upload_particles(
        self,
        table: Float64,
        links: NDArray[np.uint32],
        weights: Float64,
    ) -> Any:
        """Upload particles that move in straight lines.

        Parameters
        ----------
        table : (P, 6) array
            Positions in the common frame and colors of the points between which particles travel,
            and the spacing of points there, in units of that frame.
        links : (K, 2) array
            Rows of `table` where each particle starts and ends.
        weights : (K, 2) array
            Mass of each particle at t = 0 and at t = 1.

        Returns
        -------
        particles
        """

    def advect(
        self,
        particles: Any,
        t: float,
        scale: tuple[float, float],
        center: tuple[float, float],
    ) -> Any:
        """Move particles to time t, and transform them to pixel coordinates of a canvas.

        A particle at z in the common frame is drawn at (z - 1/2) * scale + center.

        Parameters
        ----------
        particles
        t : float
            Time, from 0 to 1.
        scale, center : (x, y), in pixels

        Returns
        -------
        splats
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
        """Average values over neighbors of like color (a joint bilateral filter).

        A point p of a grid over the same extent takes the mean over cells q with the weights

            weights(q) exp(-|p - q|^2 / (2 sigma^2)) (like + 1e-9),
            like = exp(-|G(p) - g(q)|^2 / (2 tolerance^2)),

        where |p - q| is in cells, and q is at most ceil(2 sigma) rows and columns from the cell
        nearest to p. Where the weights add up to less than 1e-30 the mean is near 0.

        Parameters
        ----------
        values : (h, w, C) array
            At most 8 channels.
        weights : (h, w) array
            At least 0.
        guide : (h, w, G) array
            Colors g of the cells, at most 8 channels.
        fine_guide : (H, W, G) array
            Colors G of the points; `guide` itself smooths over cells.
        sigma : float
            In cells.
        tolerance : float
            In units of the guide.

        Returns
        -------
        (H, W, C) array
        """

    def follow_paths(
        self, field: Float32, to_field: Affine, shape: tuple[int, int], steps: int, rounds: int
    ) -> Float32:
        """Follow the place that each point of a grid shows, while a field moves it.

        At time t a point that stands at z on the field's grid shows what was at x = z - t v(x).
        From x = z at t = 0, each step to the next time takes some rounds of
        x <- (x + z - t v(x)) / 2; so a point stays with its branch where the motion folds.

        Parameters
        ----------
        field : (h, w, 2) array
            v, in points of its grid (row, column); linear in between, and constant outside.
        to_field : Affine
            From points of the other grid to points of the field.
        shape : (H, W)
            Shape of the other grid.
        steps, rounds : int

        Returns
        -------
        (steps + 1, H, W, 2) array
            x - z at the times 0, 1 / steps, ..., 1.
        """

    def upload_spline(self, coefficients: NDArray[np.float32]) -> Any:
        """Upload a picture, as the coefficients of a cubic spline: (H, W, 4) array.

        They are those of `scipy.ndimage.spline_filter` with the mode "mirror". Beyond its border
        the picture is mirrored about the centers of its outermost pixels.
        """

    def upload_layer(self, paths: Float32, change: Float32) -> Any:
        """Upload what moves and recolors a picture.

        Parameters
        ----------
        paths : (S + 1, H, W, 2) array
            What `follow_paths` has returned; S >= 1.
        change : (h, w, 4) array
            Change of color on the grid of the field.

        Returns
        -------
        layer
        """

    def draw_layers(
        self, views: Sequence[LayerView], low: Float32, shape: tuple[int, int]
    ) -> Float32:
        """Draw two layers over one another: the sum of both, each times its weight, plus `low`.

        Between stored times and between grid points paths are linear. Where neighbors take their
        colors from places more than `records.TEAR` times as far apart as pixels, a pixel is, by
        and by, the binomial mean over 3 x 3 pixels: a tear has no steps.

        Parameters
        ----------
        views : two of LayerView
        low : (h, w, 4) array
            Added to the frame, on a grid over the extent of the canvas: linear in between.
        shape : (height, width) of the canvas, in pixels

        Returns
        -------
        (height, width, 4) array
        """

    def upload_splats(
        self,
        positions: Float32,
        colors: Float32,
        weights: Float32,
        spacings: Float32 | None = None,
    ) -> Any:
        """Upload particles at rest.

        Parameters
        ----------
        positions : (K, 2) array, in pixels
        colors : (K, 3) array
        weights : (K,) array
            Masses.
        spacings : (K,) array, optional
            Distance between neighboring particles around each particle, in pixels; 1 if not given.

        Returns
        -------
        splats
        """

    def deposit(self, splats: Any, shape: tuple[int, int]) -> tuple[Float64, Float64]:
        """Give each splat to its nearest pixel, and return sums of masses and of their squares.

        Parameters
        ----------
        splats
            Splats without individual widths.
        shape : (height, width) of the canvas, in pixels

        Returns
        -------
        mass, squares : (height, width) arrays
        """

    def adapt_widths(self, splats: Any, distances: Float64, sigma: float) -> Any:
        """Give every splat an individual width, by Eq. 3 with the distance between its neighbors.

        The width is max(sigma * spacing, distance / 2), rounded to one of the
        `width_levels.WIDTH_LEVELS` around sigma. Distances are interpolated bilinearly between
        pixels; outside the canvas, the distance at the border counts.

        Parameters
        ----------
        splats
        distances : (height, width) array
            Distance between neighboring particles around each pixel of the canvas, in pixels.
        sigma : float
            Kernel width, in units of the spacing.

        Returns
        -------
        splats
            Splats for `splat` with the same `sigma`. Weights are scaled so that the sum of
            each kernel over the canvas is that of a kernel of width sigma.
        """

    def width_levels(self, splats: Any) -> NDArray[np.int64]:
        """Return the width level of each splat: (K,) array, the base level by default."""

    def bin_splats(self, splats: Any, shape: tuple[int, int], margin: int) -> Bins:
        """Sort splats into bins.

        Parameters
        ----------
        splats
        shape : (height, width) of the canvas, in pixels
        margin : int
            Number of bins added on every side; splats farther out fall into the outermost ones.

        Returns
        -------
        Bins
        """

    def splat(
        self, splats: Any, shape: tuple[int, int], sigma: float, radius: float
    ) -> tuple[Float64, Float64]:
        """Return the two sums of a Nadaraya-Watson frame (paper, section 3.3).

        Splats with individual widths use them in place of `sigma`; `radius` is then scaled by the
        ratio of the two widths.

        Parameters
        ----------
        splats
        shape : (height, width) of the canvas, in pixels
        sigma : float
            Kernel width in pixels. With 0, each splat is given to its nearest pixel.
        radius : float
            Distance at which the kernel is cut, in pixels. A kernel counts where |dx| and |dy|
            are at most `radius`; it does not count where one of them is larger than `radius`
            plus a kernel width (`sigma`, or the splat's own). A backend may or may not count it in
            between. The kernel's error is at most `KERNEL_ERROR` of its peak, and 0 for a width of
            0.

        Returns
        -------
        numerator : (height, width, 3) array
            sum_k w_k K(p - p_k) c_k
        denominator : (height, width) array
            sum_k w_k K(p - p_k)
        """

    def nearest_seeds(self, seeds: Float32, shape: tuple[int, int]) -> NDArray[np.int32]:
        """Return the nearest seed of each pixel: the Voronoi cell that it is in.

        It minimizes the square of the distance, (x - x_k)^2 + (y - y_k)^2. A backend may round the
        four operations to float32; it takes the lowest index of the seeds that are equally near
        then, as seeds in the same place always are.

        Parameters
        ----------
        seeds : (K, 2) array, in pixels
            Positions (x, y), inside the canvas or outside of it, finite and at most 1e18; K >= 1.
        shape : (height, width) of the canvas, in pixels

        Returns
        -------
        (height, width) array
            Indices of seeds.
        """
