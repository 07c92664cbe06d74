"""How far roundings can move what a backend computes."""

from clmorph.backends.interface import Operations


def rounding_error(operations: Operations, n_columns: int, largest: float, precise: bool) -> float:
    """Return by how many nats a log-sum-exp of `operations` may be off.

    A few roundings of each term (8 units, the exponential's error included), the random
    walk of a sum of `n_columns` terms, and one rounding of an exponent of size C / epsilon;
    several happen, but tiles make the numbers smaller.

    Parameters
    ----------
    operations : Operations
    n_columns : int
    largest : float
        The largest C / epsilon.
    precise : bool
    """
    in_exponent = operations.precise_roundoff if precise else operations.exponent_roundoff
    return operations.sum_roundoff * (8 + 2 * n_columns**0.5) + in_exponent * largest
