import os
import threading
import time

import pytest
import serve_tasks

import dgc_pose.serve.worker as worker_module
from dgc_pose.serve.worker import Refused, RequestWorker, Unavailable, WorkError


@pytest.fixture(scope="module")
def worker():
    worker = RequestWorker(serve_tasks.Tasks, memory=2**29)
    yield worker
    worker.close()


def test_calls_share_another_process_and_their_reports_come_first(worker):
    reports = []
    assert worker.call("add", 2, 3, seconds=20, report=reports.append) == 5
    assert reports == ["adding 2", "and 3"]
    first, second = (worker.call("process", seconds=20) for _ in range(2))
    assert first == second != os.getpid()


@pytest.mark.parametrize(
    ("method", "error", "message"),
    [
        ("hang", WorkError, "stopped after 0.2 seconds"),
        ("crash", WorkError, "the worker's process ended: signal 6"),
        ("refuse", Refused, "this will not do"),
        ("fail", WorkError, "ZeroDivisionError"),
    ],
)
def test_whatever_happens_the_next_call_works(worker, method, error, message):
    with pytest.raises(error, match=message) as caught:
        worker.call(method, seconds=0.2)
    assert type(caught.value) is error
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
    worker = RequestWorker(make)
    with pytest.raises(Refused, match=message):
        worker.call("add", 1, 1, seconds=20)
    worker.close()
    assert "Traceback" not in capfd.readouterr().err


def _hang_in_thread(worker, errors, begun, gone=None):
    """A call that does not come to an end; what it raises goes to `errors`."""

    def call():
        try:
            worker.call("hang", seconds=60, report=lambda _: begun.set(), gone=gone)
        except WorkError as error:
            errors.append((str(error), error.status))

    thread = threading.Thread(target=call)
    thread.start()
    return thread


def test_more_calls_than_may_wait_are_turned_away_and_closing_ends_them():
    worker, errors, begun = RequestWorker(serve_tasks.Tasks, waiting=2), [], threading.Event()
    threads = [_hang_in_thread(worker, errors, begun)]
    assert begun.wait(60)
    threads.append(_hang_in_thread(worker, errors, begun))
    while worker._places._value:  # until the second call waits for the first
        time.sleep(0.01)
    with pytest.raises(Unavailable, match="busy"):
        worker.call("add", 1, 1, seconds=20)
    worker.close()
    for thread in threads:
        thread.join(20)
    assert errors == 2 * [("the server is ending", 503)]
    assert worker._process is None


def test_a_client_that_leaves_gives_up_its_place_and_ends_its_work():
    worker, errors, begun = RequestWorker(serve_tasks.Tasks, waiting=2), [], threading.Event()
    running, waiting = threading.Event(), threading.Event()
    threads = [_hang_in_thread(worker, errors, begun, running)]
    assert begun.wait(60)
    process = worker._process
    threads.append(_hang_in_thread(worker, errors, threading.Event(), waiting))
    waiting.set()
    threads[1].join(20)
    assert worker._places._value == 1 and worker._process is process and process.is_alive()
    running.set()
    threads[0].join(20)
    assert errors == 2 * [("the client has left", 503)]
    assert not process.is_alive() and worker._process.is_alive()  # the next one need not wait
    assert worker.call("add", 1, 1, seconds=20) == 2
    worker.close()


def test_a_closed_worker_starts_no_process(monkeypatch):
    worker = RequestWorker(serve_tasks.Tasks)
    worker.close()
    monkeypatch.setattr(worker_module, "_CONTEXT", None)  # nothing can be started by it
    for use in (worker.start, lambda: worker.call("add", 1, 1, seconds=20)):
        with pytest.raises(Unavailable, match="the server is ending"):
            use()


def test_closing_while_the_process_starts_ends_it(monkeypatch):
    worker, errors, starts = RequestWorker(serve_tasks.Tasks), [], threading.Event()
    go_on, started, context = threading.Event(), [], worker_module._CONTEXT

    class SlowContext:
        Pipe = staticmethod(context.Pipe)

        @staticmethod
        def Process(**arguments):
            starts.set()
            assert go_on.wait(60)
            started.append(context.Process(**arguments))
            return started[0]

    monkeypatch.setattr(worker_module, "_CONTEXT", SlowContext)
    threads = [_hang_in_thread(worker, errors, threading.Event())]
    assert starts.wait(60)
    threads.append(threading.Thread(target=worker.close))
    threads[1].start()
    while not worker._closed:
        time.sleep(0.01)
    go_on.set()
    for thread in threads:
        thread.join(20)
    assert errors == [("the server is ending", 503)]
    assert worker._process is None and not started[0].is_alive()
