"""The threads of several devices: results, failures, interruptions."""

import signal
import threading
import time

import pytest

from clmorph.backends.cancellation import Cancellation, Cancelled, check_cancelled
from clmorph.backends.threads import results_in_order


def endless(started=None):
    """Work until it is cancelled, after `started` is set; fails the test after ten seconds."""
    if started is not None:
        started.set()
    for _ in range(1000):
        check_cancelled()
        time.sleep(0.01)
    raise AssertionError("never cancelled")


def test_an_outer_request_stops_all():
    outer = Cancellation()
    timer = threading.Timer(0.1, outer.request)
    timer.start()
    with outer.applies(), pytest.raises(Cancelled):
        list(results_in_order([0, 1], lambda worker, number: endless()))
    check_cancelled()  # not requested outside
    timer.join()


def interrupt_after(started):
    """Interrupt the main thread when its work has begun; earlier, it would end all tests."""
    main = threading.main_thread().ident

    def interrupt():
        if started.wait(60):
            time.sleep(0.2)
            signal.pthread_kill(main, signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    return thread


@pytest.fixture
def no_thread_stays():
    """Of those that the test starts; threads of other tests may end meanwhile."""
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs signals to threads")
def test_ctrl_c_ends_results(no_thread_stays):
    started = threading.Event()
    thread = interrupt_after(started)
    with pytest.raises(KeyboardInterrupt):
        list(results_in_order([0, 1, 0, 1], lambda worker, number: endless(started)))
    thread.join()


def test_results_come_in_order():
    def work(worker, number):
        time.sleep(0.02 if worker == 0 else 0.001)
        return worker, number

    turns = [1, 1, 0, 1, 1, 1, 0, 2]
    assert list(results_in_order(turns, work)) == [(w, n) for n, w in enumerate(turns)]
    assert list(results_in_order([], work)) == []


def test_no_worker_runs_far_ahead():
    made = []

    def work(worker, number):
        made.append(number)
        return number

    results = results_in_order([0, 1] * 20, work)
    assert made == []  # nothing is computed before the first result is asked for
    assert next(results) == 0
    time.sleep(0.2)
    assert len(made) <= 5
    results.close()
    assert len(made) <= 5


@pytest.mark.parametrize("failing", [0, 5])
def test_a_failing_result_ends_all(failing, no_thread_stays):
    def work(worker, number):
        if number == failing:
            raise ValueError(f"result {number}")
        return number

    taken = []
    with pytest.raises(ValueError, match=f"result {failing}"):
        taken.extend(results_in_order([0, 1, 2] * 3, work))
    assert taken == list(range(len(taken)))
    assert len(taken) <= failing


def test_a_consumer_that_leaves_ends_all(no_thread_stays):
    for _ in results_in_order([0, 1] * 50, lambda worker, number: number):
        break
