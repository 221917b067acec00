from __future__ import annotations

import multiprocessing
import os
import threading
import time

import pytest
import serve_tasks

import dgc_pose.serve.worker as worker_module
from dgc_pose.serve.worker import Busy, Closed, Crashed, Refused, TimedOut, Worker


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
        ("crash", Crashed, "the worker's process ended: signal 6"),
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


def _in_thread(worker, method, errors, *, report=lambda _: None):
    """Call the method in a thread; what it raises goes to `errors`."""

    def call():
        try:
            worker.call(method, seconds=60, report=report)
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=call)
    thread.start()
    return thread


def test_more_calls_than_may_wait_are_turned_away_and_closing_ends_them():
    worker, errors, begun = Worker(serve_tasks.Tasks, waiting=2), [], threading.Event()
    threads = [_in_thread(worker, "hang", errors, report=lambda _: begun.set())]
    assert begun.wait(60)
    threads.append(_in_thread(worker, "hang", errors))
    for _ in range(6000):  # until the second call waits for the first
        if not worker._count._value:
            break
        time.sleep(0.01)
    with pytest.raises(Busy):
        worker.call("add", 1, 1, seconds=20)
    worker.close()
    for thread in threads:
        thread.join(20)
    assert [type(error) for error in errors] == [Closed, Closed]
    assert worker._process is None


def test_a_closed_worker_starts_no_process(monkeypatch):
    worker = Worker(serve_tasks.Tasks)
    worker.close()
    monkeypatch.setattr(worker_module, "_CONTEXT", None)  # nothing can be started by it
    for use in (worker.start, lambda: worker.call("add", 1, 1, seconds=20)):
        with pytest.raises(Closed, match="the server is ending") as caught:
            use()
        assert caught.value.status == 503 and worker._process is None


def test_closing_while_the_process_starts_ends_it(monkeypatch):
    worker, errors, starts = Worker(serve_tasks.Tasks), [], threading.Event()
    go_on, started = threading.Event(), []

    class SlowContext:
        Pipe = staticmethod(worker_module._CONTEXT.Pipe)

        @staticmethod
        def Process(**given):
            starts.set()
            assert go_on.wait(60)
            started.append(multiprocessing.get_context("spawn").Process(**given))
            return started[0]

    monkeypatch.setattr(worker_module, "_CONTEXT", SlowContext)
    thread = _in_thread(worker, "hang", errors)
    assert starts.wait(60)
    closing = threading.Thread(target=worker.close)
    closing.start()
    while not worker._closed:
        time.sleep(0.01)
    go_on.set()
    for each in (thread, closing):
        each.join(20)
    assert [type(error) for error in errors] == [Closed]
    assert worker._process is None and not started[0].is_alive()
