"""Work in threads, in order."""

import threading
import time

import pytest

from clmorph._shared.threads import MOST_THREADS, in_order


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
    before = set(threading.enumerate())
    results = in_order(lambda number: number, range(100))
    next(results)
    results.close()
    # Threads of other tests may end meanwhile.
    assert not set(threading.enumerate()) - before
