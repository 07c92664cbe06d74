"""The operations of `clmorph.backends.interface.Operations` on several devices at once."""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.validation import shown
from clmorph.backends.interface import Operations
from clmorph.backends.records import Float64, NearPairs, StoredPairs, StoredVectors
from clmorph.backends.several.clouds import Cloud, Part, divide_rows
from clmorph.backends.several.plan_rows import PlanRowsOfParts
from clmorph.backends.several.team import Team, in_order, own_pairs
from clmorph.errors import InputError


class SeveralDevices:
    """Operations whose rows are divided over devices; safe to share between threads.

    Each device holds the whole cloud as columns, and its share of the points as rows. An operation
    runs on all devices at the same time, one thread a device, and its result has the caller's
    order. Particles are on one device, the one with the largest share, because
    `clmorph.frames.spread` gives whole frames to devices. So are batches of clouds, whose problems
    are small.

    The shares of the rows, and of the frames, are above 0, and equal if not given; they decide how
    results are rounded. `memory_bytes` is the least memory of a device, because each device holds
    the whole problem; devices in the host's memory have equal parts of what each of them reports.
    """

    def __init__(
        self, members: Sequence[Operations], shares: Sequence[float] | None = None
    ) -> None:
        team = self._team = Team(members)
        self.members = team.members
        given = [1.0] * len(self.members) if shares is None else list(shares)
        if not self.members or len(given) != len(self.members) or not _are_shares(given):
            raise InputError(
                f"shares={shown(shares)}: expected a number above 0 for each of "
                f"{len(self.members)} devices"
            )
        self.shares = [share / sum(given) for share in given]

        self.description = " + ".join(
            f"{100 * share:.3g} % {member.description}"
            for share, member in zip(self.shares, self.members, strict=True)
        )
        self.sum_roundoff = max(member.sum_roundoff for member in members)
        self.exponent_roundoff = max(member.exponent_roundoff for member in members)
        self.precise_roundoff = max(member.precise_roundoff for member in members)
        self.has_float64 = all(member.has_float64 for member in members)
        self.max_spread = min(member.max_spread for member in members)
        self.memory_bytes = _least_memory(members)
        self.shares_host_memory = any(member.shares_host_memory for member in members)
        self.on_processor = all(member.on_processor for member in members)
        self.pairs_per_second = sum(member.pairs_per_second for member in members)
        keys = "|".join(member.record_key for member in members)
        self.record_key = hashlib.sha256(keys.encode()).hexdigest()[:32]

        plans = PlanRowsOfParts(team)
        self.count_plan_rows = plans.count_plan_rows
        self.plan_rows = plans.plan_rows
        self.store_pairs = plans.store_pairs
        self.sum_stored = plans.sum_stored
        lone = self.members[int(np.argmax(self.shares))]
        self.bin_size = lone.bin_size
        self.upload_batch, self.take_batch = lone.upload_batch, lone.take_batch
        self.softmin_batch = lone.softmin_batch
        self.bounded_softmin_batch = lone.bounded_softmin_batch
        self.upload_particles = lone.upload_particles
        self.upload_splats = lone.upload_splats
        self.edge_preserving_mean = lone.edge_preserving_mean
        self.follow_paths = lone.follow_paths
        self.upload_spline, self.upload_layer = lone.upload_spline, lone.upload_layer
        self.draw_layers = lone.draw_layers
        self.advect = lone.advect
        self.deposit = lone.deposit
        self.adapt_widths = lone.adapt_widths
        self.width_levels = lone.width_levels
        self.bin_splats = lone.bin_splats
        self.splat = lone.splat
        self.nearest_seeds = lone.nearest_seeds

    def __repr__(self) -> str:
        return f"<SeveralDevices: {self.description}>"

    def upload(self, points: Float64, weights: Float64, offsets: Float64 | None = None) -> Cloud:
        """Upload a weighted cloud to every device, and its rows to one device each."""
        points, weights = np.asarray(points, float), np.asarray(weights, float)
        divided = dict(divide_rows(points, self.shares))

        def upload(member: Operations, number: int) -> tuple[Any, Any]:
            whole = member.upload(points, weights, offsets)
            rows = divided.get(number)
            if rows is None or len(divided) == 1:
                return whole, whole
            of_rows = None if offsets is None else offsets[rows]
            return whole, member.upload(points[rows], weights[rows], of_rows)

        made = self._team.on_each(upload)
        parts = [Part(number, rows, made[number][1]) for number, rows in divided.items()]
        if len(parts) == 1:
            # The whole cloud is in the caller's order.
            parts = [parts[0]._replace(rows=np.arange(len(points)))]
        return Cloud(len(points), [whole for whole, _ in made], parts)

    def softmin(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon)."""

        def of_part(member: Operations, part: Part, place: int) -> Float64:
            whole = columns.whole[part.member]
            own = own_pairs(near, place)
            return member.softmin(part.cloud, whole, potential, epsilon, precise, own)

        return in_order(rows, self._team.over_parts(rows, of_part))

    def start_iteration(
        self,
        rows: Cloud,
        columns: Cloud,
        weights: tuple[Float64, Float64],
        inverse_rho: tuple[float, float],
    ) -> None:
        """Return None: the parts of a softmin meet on the host."""

    def bounded_softmin(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
        enough: float = 0.0,
    ) -> tuple[Float64, float]:
        """Return the soft minimum, and the largest of the devices' bounds of its rounding error."""

        def of_part(member: Operations, part: Part, place: int) -> tuple[Float64, float]:
            whole = columns.whole[part.member]
            return member.bounded_softmin(
                part.cloud, whole, potential, epsilon, own_pairs(near, place), enough
            )

        found = self._team.over_parts(rows, of_part)
        softmin = in_order(rows, [(part, values) for part, (values, _) in found])
        return softmin, max(error for _, (_, error) in found)

    def near_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        softmin: Float64,
        epsilon: float,
        budget: float,
    ) -> NearPairs:
        """Find the pairs that contribute to the rows' sums, each device for its rows."""

        def of_part(member: Operations, part: Part, place: int) -> NearPairs:
            whole = columns.whole[part.member]
            guess = softmin[part.rows]
            return member.near_pairs(part.cloud, whole, potential, guess, epsilon, budget)

        found = self._team.over_parts(rows, of_part)
        near = [own for _, own in found]
        return NearPairs(
            near,
            in_order(rows, [(part, own.softmin) for part, own in found]),
            in_order(rows, [(part, own.skipped) for part, own in found]),
            sum(own.n_pairs for own in near),
            max(own.n_columns for own in near),
            max(own.largest for own in near),
        )

    def row_maxima(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j], in nats."""

        def of_part(member: Operations, part: Part, place: int) -> Float64:
            whole = columns.whole[part.member]
            return member.row_maxima(part.cloud, whole, potential, epsilon, own_pairs(near, place))

        return in_order(rows, self._team.over_parts(rows, of_part))

    def start_stored_iteration(
        self,
        stored: StoredPairs,
        vectors: tuple[StoredVectors, StoredVectors],
        center: Float64,
        inverse_rho: tuple[float, float],
        over: Any = None,
    ) -> None:
        """Return None: a column's pairs are on several devices."""

    def barycentric_projection(
        self,
        rows: Any,
        columns: Any,
        g: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> tuple[Float64, Float64]:
        """Return T(g), and the mean of each row's destinations."""

        def of_part(member: Operations, part: Part, place: int) -> tuple[Float64, Float64]:
            whole = columns.whole[part.member]
            own = own_pairs(near, place)
            return member.barycentric_projection(part.cloud, whole, g, epsilon, precise, own)

        found = self._team.over_parts(rows, of_part)
        softmin = in_order(rows, [(part, own) for part, (own, _) in found])
        return softmin, in_order(rows, [(part, own) for part, (_, own) in found])

    def plan_moments(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> tuple[Float64, Float64]:
        """Return mean and covariance of each row's destinations."""

        def of_part(member: Operations, part: Part, place: int) -> tuple[Float64, Float64]:
            whole = columns.whole[part.member]
            sums = softmin[part.rows]
            own = own_pairs(near, place)
            return member.plan_moments(part.cloud, whole, g, sums, epsilon, precise, own)

        found = self._team.over_parts(rows, of_part)
        mean = in_order(rows, [(part, own) for part, (own, _) in found])
        return mean, in_order(rows, [(part, own) for part, (_, own) in found])

    def sample_plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        thresholds: Float64,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> NDArray[np.int32]:
        """Return columns drawn from each plan row."""

        def of_part(member: Operations, part: Part, place: int) -> NDArray[np.int32]:
            return member.sample_plan_rows(
                part.cloud, columns.whole[part.member], g, softmin[part.rows], epsilon,
                thresholds[part.rows], precise, own_pairs(near, place),
            )  # fmt: skip

        return in_order(rows, self._team.over_parts(rows, of_part))


def _are_shares(values: Sequence[Any]) -> bool:
    """Return whether all values are finite numbers above 0."""
    return all(isinstance(value, int | float) and 0 < value < float("inf") for value in values)


def _least_memory(members: Sequence[Operations]) -> int | None:
    """Return the memory that every device has; None if none has a limit of its own."""
    on_host = sum(member.shares_host_memory for member in members)
    limits = [
        member.memory_bytes // (on_host if member.shares_host_memory else 1)
        for member in members
        if member.memory_bytes is not None
    ]
    return min(limits, default=None)
