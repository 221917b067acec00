"""A test that hangs fails, and the tests after it run."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def no_hang(seconds: int) -> Iterator[None]:
    """Fails the test, with the trace of where it waits, after that many seconds."""

    def fail(*_: object) -> None:
        pytest.fail(f"does not end within {seconds} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
