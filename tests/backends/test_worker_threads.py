"""The threads of several devices: results, failures, interruptions."""

import os
import signal
import subprocess
import sys
import threading
import time
import weakref

import numpy as np
import pytest

from clmorph.backends.cancellation import Cancellation, Cancelled, check_cancelled
from clmorph.backends.several import results_in_order
from clmorph.backends.several.threads import Workers


def endless(started=None):
    """Work until it is cancelled; fails the test after ten seconds."""
    if started is not None:
        started.set()
    for _ in range(1000):
        check_cancelled()
        time.sleep(0.01)
    raise AssertionError("never cancelled")


def test_tasks_run_at_the_same_time():
    workers = Workers(3)
    for _ in range(3):
        meeting = threading.Barrier(4, timeout=10)
        tasks = [lambda number=number: (meeting.wait() >= 0, number) for number in range(4)]  # noqa: B023
        assert workers.run_at_once(tasks) == [(True, number) for number in range(4)]
    assert workers.run_at_once([threading.get_ident]) == [threading.get_ident()]
    assert workers.run_at_once([threading.get_ident] * 3)[0] == threading.get_ident()


def test_the_callers_settings_hold_in_threads():
    with np.errstate(divide="raise"):
        first, second = Workers(1).run_at_once([np.geterr, np.geterr])
    assert first == second
    assert second["divide"] == "raise"


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_a_failure_stops_the_others(failing):
    started = threading.Barrier(3, timeout=10)

    def task(number):
        started.wait()
        if number == failing:
            raise ValueError(f"task {number}")
        endless()

    began = time.perf_counter()
    with pytest.raises(ValueError, match=f"task {failing}"):
        Workers(2).run_at_once([lambda number=number: task(number) for number in range(3)])
    assert time.perf_counter() - began < 5


def test_an_error_keeps_no_cloud_alive():
    class Cloud:
        pass

    def attempt():
        cloud = Cloud()
        gone = weakref.ref(cloud)

        def fail():
            raise ValueError(cloud)

        with pytest.raises(ValueError):
            Workers(1).run_at_once([lambda: None, fail])
        return gone

    import gc

    gone = attempt()
    gc.collect()
    assert gone() is None


def test_an_outer_request_stops_all():
    outer = Cancellation()
    timer = threading.Timer(0.1, outer.request)
    timer.start()
    with outer.applies(), pytest.raises(Cancelled):
        Workers(1).run_at_once([endless, endless])
    with outer.applies(), pytest.raises(Cancelled):
        list(results_in_order([0, 1], lambda worker, number: endless()))
    check_cancelled()  # not requested outside
    timer.join()


def interrupt_soon():
    main = threading.main_thread().ident
    timer = threading.Timer(0.2, lambda: signal.pthread_kill(main, signal.SIGINT))
    timer.start()
    return timer


def threads_since(before):
    """Return threads that were not there before; threads of other tests may end meanwhile."""
    return set(threading.enumerate()) - before


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs signals to threads")
@pytest.mark.parametrize("tasks", [(endless, endless), (lambda: None, endless)])
def test_ctrl_c_ends_all_tasks(tasks):
    ended = threading.Event()

    def last():
        try:
            tasks[1]()
        finally:
            ended.set()

    timer = interrupt_soon()
    with pytest.raises(KeyboardInterrupt):
        Workers(1).run_at_once([tasks[0], last])
    assert ended.is_set()
    timer.join()


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs signals to threads")
def test_ctrl_c_ends_results():
    before = set(threading.enumerate())
    timer = interrupt_soon()
    with pytest.raises(KeyboardInterrupt):
        list(results_in_order([0, 1, 0, 1], lambda worker, number: endless()))
    timer.join()
    assert not threads_since(before)


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
def test_a_failing_result_ends_all(failing):
    def work(worker, number):
        if number == failing:
            raise ValueError(f"result {number}")
        return number

    before, taken = set(threading.enumerate()), []
    with pytest.raises(ValueError, match=f"result {failing}"):
        taken.extend(results_in_order([0, 1, 2] * 3, work))
    assert taken == list(range(len(taken)))
    assert len(taken) <= failing
    assert not threads_since(before)


def test_a_consumer_that_leaves_ends_all():
    before = set(threading.enumerate())
    for _ in results_in_order([0, 1] * 50, lambda worker, number: number):
        break
    assert not threads_since(before)


def test_threads_end_with_their_object():
    before = set(threading.enumerate())
    workers = Workers(2)
    workers.run_at_once([lambda: None] * 3)
    assert len(threads_since(before)) == 2
    del workers
    for _ in range(100):
        if not threads_since(before):
            return
        time.sleep(0.02)
    raise AssertionError("threads are left")


FORKS = """
import os
import warnings

import numpy as np

from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.several import SeveralDevices

several = SeveralDevices([NumPyOperations(), NumPyOperations()])
points = np.random.default_rng(0).random((200, 2))
cloud = several.upload(points, np.ones(200))
want = several.softmin(cloud, cloud, np.zeros(200), 0.1)
warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of forks with threads
child = os.fork()
if child == 0:
    same = np.array_equal(several.softmin(cloud, cloud, np.zeros(200), 0.1), want)
    os._exit(0 if same else 1)
print("status", os.waitpid(child, 0)[1])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_has_threads_of_its_own():
    # A process of its own forks: libraries that other tests have loaded here may not bear a fork.
    process = subprocess.Popen(
        [sys.executable, "-c", FORKS], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        output, _ = process.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)  # the child with its parent
        process.communicate()
        raise AssertionError("the child waits for threads that it does not have") from None
    assert process.returncode == 0
    assert output == "status 0\n"
