"""A process that works on one request at a time, each within a time limit.

Decoders of images are written in C. If one crashes, or does not come to an end, its process ends
and the server goes on with a fresh one.
"""

import math
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from dgc_pose.errors import DgcPoseError, missing_package, reason
from dgc_pose.system.processes import process_end

Report = Callable[[str], None]  # takes what is being done, for people
_ENDING_SECONDS = 5  # for a process that has closed its pipe
_LOOK_SECONDS = 0.1  # between looks whether the answer is still wanted
_CONTEXT = multiprocessing.get_context("spawn")  # no copy of the server's sockets


class WorkError(DgcPoseError):
    """A request that came to no result; the message is one line for the client."""

    status = 422  # of HTTP


class Refused(WorkError):
    """The worker refused its input."""


class Unavailable(WorkError):
    """Too many requests wait already, the client has left, or the server ends."""

    status = 503


class RequestWorker:
    """A process with an object, whose methods are called from here.

    make: a picklable function without arguments, called in the process, that makes the object. Each
    method takes a `Report` first. waiting: calls at a time; more are turned away. memory: bytes of
    address space that the process may take, beyond what it starts with; None for no bound.
    """

    def __init__(
        self, make: Callable[[], Any], *, waiting: int = 4, memory: int | None = None
    ) -> None:
        self._make, self._memory = make, memory
        self._lock, self._places = threading.Lock(), threading.Semaphore(waiting)
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._closed = False

    def start(self) -> None:
        """Start the process, if it does not run, without waiting for its object.

        Raises Unavailable if the worker is closed.
        """
        with self._lock:
            self._started()

    def call(
        self,
        method: str,
        *arguments: Any,
        seconds: float,
        report: Report = lambda _: None,
        gone: threading.Event | None = None,
    ) -> Any:
        """What the method returns. Blocks; for threads.

        seconds: of the method's own work. report: is called in this thread. gone: is set when
        nobody waits for the answer any more: the call ends, and its work. Raises WorkError:
        Refused with the message of a DgcPoseError or OSError of the method, Unavailable, or
        WorkError itself if the time has passed, the process ends or its code fails.
        """
        if not self._places.acquire(blocking=False):
            raise Unavailable("the server is busy: try again in a moment")
        try:
            while not self._lock.acquire(timeout=_LOOK_SECONDS):
                self._check_wanted(gone)
            try:
                return self._answer((method, arguments), seconds, report, gone)
            except (EOFError, OSError):  # of the pipe
                code = self._end(_ENDING_SECONDS)
                raise WorkError(f"the worker's process ended: {process_end(code)}") from None
            except Unavailable:
                self._end()
                self._started()  # for the next call
                raise
            finally:
                self._lock.release()
        finally:
            self._places.release()

    def close(self) -> None:
        """End the process for good; calls under way, waiting and later ones raise Unavailable."""
        self._closed = True
        with self._lock:
            self._end()

    def _answer(
        self,
        request: tuple[str, Any],
        seconds: float,
        report: Report,
        gone: threading.Event | None,
    ) -> Any:
        pipe = self._started()
        pipe.send(request)
        deadline = math.inf  # until the object is made: loading a network is not the client's fault
        while (left := deadline - time.monotonic()) > 0:
            self._check_wanted(gone)
            if not pipe.poll(min(left, _LOOK_SECONDS)):
                continue
            kind, value = pipe.recv()
            match kind:
                case "begun":
                    deadline = time.monotonic() + seconds
                case "report":
                    report(value)
                case "done":
                    return value
                case "refused":
                    raise Refused(value)
                case "failed":
                    raise WorkError(value)
        self._end()
        raise WorkError(f"stopped after {seconds:g} seconds")

    def _started(self) -> Connection:
        self._check_wanted()
        if self._process is None or not self._process.is_alive() or self._pipe is None:
            self._end()
            ours, theirs = _CONTEXT.Pipe()
            arguments = (theirs, self._make, self._memory)
            process = _CONTEXT.Process(target=_work, args=arguments, daemon=True)
            process.start()
            theirs.close()
            self._process, self._pipe = process, ours
        return self._pipe

    def _check_wanted(self, gone: threading.Event | None = None) -> None:
        """Raise Unavailable if the worker is closed, or the client gone."""
        if self._closed:
            raise Unavailable("the server is ending") from None
        if gone is not None and gone.is_set():
            raise Unavailable("the client has left")

    def _end(self, seconds: float = 0) -> int | None:
        """End the process, unless it ends by itself within so many seconds. Returns its exit
        code."""
        code = None
        if self._process is not None:
            self._process.join(seconds)
            self._process.kill()
            self._process.join()
            code = self._process.exitcode
        if self._pipe is not None:
            self._pipe.close()
        self._process, self._pipe = None, None
        return code


def _work(pipe: Connection, make: Callable[[], Any], memory: int | None) -> None:
    """The process: calls of the object's methods, until the server is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server ends it
    try:
        target = make()
    except Exception as error:  # of any library: without its object the process has no use
        pipe.send(("refused", _refusal(error) or reason(error)))
        return
    if memory is not None:
        _bound_memory(memory)
    with suppress(EOFError, OSError):  # of the pipe: the server is gone
        while True:
            method, arguments = pipe.recv()
            pipe.send(("begun", None))
            pipe.send(_outcome(getattr(target, method), pipe, arguments))


def _outcome(
    method: Callable[..., Any], pipe: Connection, arguments: tuple[Any, ...]
) -> tuple[str, Any]:
    try:
        return "done", method(lambda text: pipe.send(("report", text)), *arguments)
    except Exception as error:
        refusal = _refusal(error)
        if refusal is not None:
            return "refused", refusal
        traceback.print_exc()
        return "failed", f"the server failed: {type(error).__name__}"


def _refusal(error: Exception) -> str | None:
    """What the client is told of an error that is not the server's; one line."""
    match error:
        case DgcPoseError() | OSError():
            return " ".join(str(error).split())
        case MemoryError():
            return f"not enough memory: {reason(error)}"
        case ModuleNotFoundError():
            return missing_package(error)
    return None


def _bound_memory(extra: int) -> None:
    """Let the process take so many bytes more than it has; only on Linux."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        with open("/proc/self/statm", encoding="ascii") as file:
            pages = int(file.read().split()[0])
        bound = pages * os.sysconf("SC_PAGE_SIZE") + extra
        resource.setrlimit(resource.RLIMIT_AS, (bound, bound))
