"""A process that works on one request at a time, each within a time limit.

Decoders of images are written in C. If one crashes, or does not come to an end, its process ends
and the server goes on with a fresh one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

from dgc_pose.errors import DgcPoseError, missing_package, reason
from dgc_pose.system.processes import process_end

Report = Callable[[str], None]  # takes what is being done, for people
_ENDING_SECONDS = 5  # for a process that has closed its pipe
_CONTEXT = multiprocessing.get_context("spawn")  # no copy of the server's sockets


class WorkError(DgcPoseError):
    """A request that came to no result; the message is one line for the client."""

    status = 422  # of HTTP


class Refused(WorkError):
    """The worker refused its input."""


class TimedOut(WorkError):
    """The time limit passed."""


class Crashed(WorkError):
    """The worker's process ended, or its code failed."""


class Busy(WorkError):
    """Too many requests wait already."""

    status = 503


class Closed(WorkError):
    """The worker was closed: the server ends."""

    status = 503


class Worker:
    """A process with one object, whose methods are called from here.

    make: a picklable function without arguments, called in the process, that makes the object. Each
    method takes a `Report` first. memory: bytes of address space that the process may take, beyond
    what it starts with; None for no bound.
    """

    def __init__(
        self, make: Callable[[], Any], *, waiting: int = 4, memory: int | None = None
    ) -> None:
        self._make, self._memory, self._most = make, memory, waiting
        self._lock, self._count = threading.Lock(), threading.Semaphore(waiting)
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._closed = False

    def start(self) -> None:
        """Start the process, if it does not run, without waiting for its object.

        Raises Closed.
        """
        with self._lock:
            self._started()

    def call(
        self, method: str, *arguments: Any, seconds: float, report: Report = lambda _: None
    ) -> Any:
        """What the method returns. Blocks; for threads.

        report: is called in this thread. Raises WorkError: Refused with the message of a
        DgcPoseError or OSError of the method, TimedOut after so many seconds of its work, Crashed,
        Busy, or Closed.
        """
        with self._queued():
            pipe = self._started()
            try:
                pipe.send((method, arguments))
                return self._answer(pipe, seconds, report)
            except (EOFError, OSError):
                if self._process is not None:
                    self._process.join(_ENDING_SECONDS)  # or the exit code would be that of _end
                code = self._end()
                self._check_open()
                raise Crashed(f"the worker's process ended: {process_end(code)}") from None
            except TimedOut:
                self._end()
                raise

    def close(self) -> None:
        """End the process for good; calls under way, waiting and later ones raise Closed."""
        self._closed = True  # before the process is read, as _started sets it before it reads this
        process = self._process
        if process is not None:
            process.kill()
        with self._lock:
            self._end()

    @contextmanager
    def _queued(self) -> Iterator[None]:
        if not self._count.acquire(blocking=False):
            raise Busy("the server is busy: try again in a moment")
        try:
            with self._lock:
                yield
        finally:
            self._count.release()

    def _started(self) -> Connection:
        self._check_open()
        if self._process is None or not self._process.is_alive() or self._pipe is None:
            self._end()
            ours, theirs = _CONTEXT.Pipe()
            arguments = (theirs, self._make, self._memory)
            process = _CONTEXT.Process(target=_work, args=arguments, daemon=True)
            process.start()
            theirs.close()
            self._process, self._pipe = process, ours
            self._check_open()  # close() may have found no process to end
        return self._pipe

    def _check_open(self) -> None:
        """Raise Closed, with the process ended, if the worker is closed."""
        if self._closed:
            self._end()
            raise Closed("the server is ending") from None

    def _answer(self, pipe: Connection, seconds: float, report: Report) -> Any:
        deadline = None  # from when the object is made: loading a network is not the client's fault
        while True:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            if not pipe.poll(left):
                raise TimedOut(f"stopped after {seconds:g} seconds")
            kind, value = pipe.recv()
            if kind == "begun":
                deadline = time.monotonic() + seconds
            elif kind == "report":
                report(value)
            elif kind == "done":
                return value
            else:
                raise {"refused": Refused, "failed": Crashed}[kind](value)

    def _end(self) -> int | None:
        """End the process, if it has not ended. Returns its exit code."""
        code = None
        if self._process is not None:
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
        told = str(error) if isinstance(error, (DgcPoseError, OSError)) else reason(error)
        pipe.send(("refused", " ".join(told.split())))
        return
    if memory is not None:
        _bound_memory(memory)
    while True:
        try:
            method, arguments = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(("begun", None))
        try:
            value = getattr(target, method)(lambda text: pipe.send(("report", text)), *arguments)
            pipe.send(("done", value))
        except (DgcPoseError, OSError) as error:
            pipe.send(("refused", " ".join(str(error).split())))
        except MemoryError as error:
            pipe.send(("refused", f"not enough memory: {reason(error)}"))
        except Exception as error:
            missing = missing_package(error) if isinstance(error, ModuleNotFoundError) else None
            if missing is not None:
                pipe.send(("refused", missing))
                continue
            traceback.print_exc(file=sys.stderr)
            pipe.send(("failed", f"the server failed: {type(error).__name__}"))


def _bound_memory(extra: int) -> None:
    """Let the process take so many bytes more than it has; only on Linux."""
    try:
        import resource

        with open("/proc/self/statm", encoding="ascii") as file:
            pages = int(file.read().split()[0])
        bound = pages * os.sysconf("SC_PAGE_SIZE") + extra
        resource.setrlimit(resource.RLIMIT_AS, (bound, bound))
    except (ImportError, OSError, ValueError):
        pass
