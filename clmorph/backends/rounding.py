"""Estimate the rounding errors in the results of a backend."""

from typing import Any

from clmorph.backends.interface import Operations


def rounding_error(
    operations: Operations, n_columns: Any, largest: Any, precise: bool, exact: bool = False
) -> Any:
    """Return the rounding error that a log-sum-exp of `operations` may have, in nats.

    The estimate adds a few roundings of each term (8 units, the exponential's error included),
    the random walk of a sum of `n_columns` terms, and one rounding of an exponent of size
    C / epsilon. An exponent is rounded several times, but tiles make the numbers smaller.

    Parameters
    ----------
    operations : Operations
    n_columns : int, or an array of them
        Number of terms of each sum.
    largest : float, or an array of them
        The largest C / epsilon.
    precise : bool
        Whether exponents are formed in more than float32.
    exact : bool
        Whether powers and sums are, too, as in `Operations.bounded_softmin`.

    Examples
    --------
    >>> from clmorph.backends.numpy import NumPyOperations
    >>> from clmorph.backends.rounding import rounding_error
    >>> rounding_error(NumPyOperations(), 100, 1000.0, precise=False) < 1e-12
    True
    """
    in_exponent = operations.exponent_roundoff
    if precise or exact:
        in_exponent = operations.precise_roundoff
    in_sum = operations.precise_roundoff if exact else operations.sum_roundoff
    return in_sum * (8 + 2 * n_columns**0.5) + in_exponent * largest
