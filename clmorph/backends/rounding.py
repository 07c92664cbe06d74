"""Estimate the rounding errors in the results of a backend."""

from typing import Any

from clmorph.backends.interface import Operations


def rounding_error(
    operations: Operations, n_columns: Any, largest: Any, precise: bool, exact: bool = False
) -> Any:
    """Return the rounding error that a log-sum-exp of `operations` may have, in nats.

    The estimate adds a few roundings of each term (8 units, the exponential's error included), the
    random walk of a sum of `n_columns` terms, and one rounding of an exponent of size C / epsilon,
    at most `largest`. An exponent is rounded several times, but tiles make the numbers smaller.
    With `precise`, exponents are formed in more than float32; with `exact`, powers and sums are,
    too, as in `Operations.bounded_softmin`.
    """
    in_exponent = operations.exponent_roundoff
    if precise or exact:
        in_exponent = operations.precise_roundoff
    in_sum = operations.precise_roundoff if exact else operations.sum_roundoff
    return in_sum * (8 + 2 * n_columns**0.5) + in_exponent * largest
