"""Work in threads, in order."""

import threading
import time

import numpy as np
import pytest

from clmorph._shared.threads import MOST_THREADS, in_order, one_ahead


def test_results_stay_in_order_and_few_wait():
    taken, done = [], []

    def items():
        for number in range(20):
            taken.append((number, len(done)))
            yield number

    def slow(number):
        time.sleep(0.002 * (number % 3))
        return 10 * number

    for number, result in in_order(slow, items()):
        assert result == 10 * number
        done.append(number)
    assert done == list(range(20))
    assert all(number - got <= MOST_THREADS for number, got in taken)


def test_items_are_taken_in_this_thread():
    here = threading.get_ident()

    def items():
        for _ in range(5):
            assert threading.get_ident() == here
            yield None

    assert len(list(in_order(lambda item: item, items()))) == 5


def test_errors_come_at_their_item():
    results = in_order(lambda number: 1 / number, [2, 1, 0, 4])
    assert [next(results), next(results)] == [(2, 0.5), (1, 1.0)]
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_a_caller_who_stops_leaves_no_thread():
    before = threading.active_count()
    results = in_order(lambda number: number, range(100))
    next(results)
    results.close()
    assert threading.active_count() == before


def test_one_item_is_made_ahead():
    made, done = [], []

    def items():
        for number in range(5):
            made.append(number)
            yield number

    for item in one_ahead(items()):
        while len(made) < min(5, item + 2):  # the next one is made before this one is done
            time.sleep(0.001)
        assert len(made) <= item + 2
        done.append(item)
    assert done == list(range(5))


def test_what_the_maker_raises_is_raised_at_its_item():
    def items():
        yield 1
        raise ValueError("no second one")

    taken = []
    with pytest.raises(ValueError, match="no second one"):
        taken += one_ahead(items())
    assert list(one_ahead(iter(()))) == []


def test_the_maker_has_the_callers_context():
    def items():
        yield np.geterr()["divide"]

    with np.errstate(divide="ignore"):
        assert list(one_ahead(items())) == ["ignore"]
    with np.errstate(divide="raise"):
        assert list(one_ahead(items())) == ["raise"]
