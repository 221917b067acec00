from __future__ import annotations

import os
import threading

import pytest
import serve_tasks

from dgc_pose.serve.worker import Busy, Crashed, Refused, TimedOut, Worker


@pytest.fixture(scope="module")
def worker():
    worker = Worker(serve_tasks.Tasks, memory=2**29)
    yield worker
    worker.close()


def test_a_call_returns_what_the_method_does_and_its_reports_come_first(worker):
    reports = []
    assert worker.call("add", 2, 3, seconds=20, report=reports.append) == 5
    assert reports == ["adding 2", "and 3"]


def test_calls_share_a_process_which_is_another_one(worker):
    first, second = (worker.call("process", seconds=20) for _ in range(2))
    assert first == second != os.getpid()


@pytest.mark.parametrize(
    ("method", "error", "message"),
    [
        ("hang", TimedOut, "stopped after 0.2 seconds"),
        ("crash", Crashed, "brought its worker down"),
        ("refuse", Refused, "this will not do"),
        ("fail", Crashed, "ZeroDivisionError"),
    ],
)
def test_whatever_happens_the_next_call_works(worker, method, error, message):
    with pytest.raises(error, match=message) as caught:
        worker.call(method, seconds=0.2)
    assert caught.value.status == 422 and "\n" not in str(caught.value)
    assert worker.call("add", 1, 1, seconds=20) == 2


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="Linux alone bounds memory")
def test_memory_is_bounded(worker):
    assert worker.call("fill", 2**20, seconds=20) == 2**20
    with pytest.raises(Refused, match="memory"):
        worker.call("fill", 2**31, seconds=20)


@pytest.mark.parametrize(
    ("make", "message"),
    [(serve_tasks.no_tasks, "no such weights"), (serve_tasks.broken_tasks, "a library's own")],
)
def test_an_object_that_cannot_be_made_is_a_refusal(make, message, capfd):
    worker = Worker(make)
    with pytest.raises(Refused, match=message):
        worker.call("add", 1, 1, seconds=20)
    worker.close()
    assert "Traceback" not in capfd.readouterr().err


def test_more_calls_than_may_wait_are_turned_away_and_closing_ends_them():
    worker = Worker(serve_tasks.Tasks, waiting=1)
    assert worker.call("add", 1, 1, seconds=20) == 2
    errors = []

    def hang():
        try:
            worker.call("hang", seconds=60)
        except Crashed as error:
            errors.append(error)

    thread = threading.Thread(target=hang)
    thread.start()
    while worker._count._value:  # until the call has begun
        pass
    with pytest.raises(Busy):
        worker.call("add", 1, 1, seconds=20)
    worker.close()
    thread.join(20)
    assert len(errors) == 1
