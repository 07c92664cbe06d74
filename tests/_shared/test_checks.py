"""Numbers are taken exactly as they are, or refused in one short line."""

from decimal import Decimal

import numpy as np
import plain
import pytest
from api_values import Hostile, OnDevice

import clmorph
from clmorph._shared.validation import (
    SHOWN_LENGTH,
    as_float,
    check_choice,
    check_integer,
    check_number,
    shown,
)
from clmorph.errors import InputError

HUGE = 10**400
#: More digits than Python prints.
ENDLESS = 10**5000


def test_whole_numbers_are_exact():
    """Those that floats would round, too."""
    for value in (2**53 + 1, 2**63 - 1, np.int64(2**63 - 1), np.uint64(2**63), np.array(7), 7.0,
                  np.float32(7)):  # fmt: skip
        assert check_integer("seed", value, 0, 2**63) == int(value)
    with pytest.raises(clmorph.InputError, match="whole number in"):
        check_integer("seed", 2**63 + 1, 0, 2**63)


@pytest.mark.parametrize(
    "value",
    [
        HUGE, -HUGE, ENDLESS, 1e400, float("nan"), 2.5, True, np.True_, np.array(True), "3", b"3",
        None, [3], {}, 3j, np.zeros((40, 40)), np.zeros(0), "x" * 10_000, [[1, 2], [3]], 10,
        np.array([3]), np.array("1"), np.timedelta64(1), np.ma.masked, np.ma.array(3, mask=True),
        Decimal("NaN"), Hostile(), OnDevice(),
    ],
    ids=lambda value: shown(value)[:20],
)  # fmt: skip
def test_what_is_none_is_refused_in_one_line(value):
    for check in (lambda: check_integer("n", value, 0, 9), lambda: check_number("n", value, 0, 2)):
        with pytest.raises(clmorph.InputError, match=r"^n=.*: expected a ") as caught:
            check()
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < SHOWN_LENGTH + 60


def test_choices_are_shown_in_one_line():
    for value in (ENDLESS, np.zeros((40, 40)), "a" * 10_000, "a\nb"):
        with pytest.raises(clmorph.InputError, match="expected one of 'x', 'y'") as caught:
            check_choice("mode", value, ("x", "y"))
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < SHOWN_LENGTH + 60


def test_a_shape_that_is_none():
    class Odd:
        shape = 5

        def __float__(self):
            return 1.0

    assert as_float(Odd()) is None
    with pytest.raises(InputError, match="blur="):
        plain.morph(np.zeros((4, 4, 3)), np.zeros((4, 4, 3)), 2, blur=Odd(), backend="numpy")


def test_containers_are_shown_in_part():
    deep = []
    for _ in range(5000):
        deep = [deep]
    for value in (deep, ["x" * 10**6] * 1000, {"k": list(range(10**6))}, 10**5000):
        assert len(shown(value)) <= 60
    assert shown([1, "a"]) == "[1, 'a']"
