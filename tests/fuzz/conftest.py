"""A test that hangs fails, and the tests after it run."""

import signal
from collections.abc import Callable, Iterator

import pytest

HANG_S = 120  # of one file or one command, on a busy machine


@pytest.fixture(autouse=True)
def begin_anew() -> Iterator[Callable[[], object]]:
    """Gives what allows so many seconds more: a test of many files calls it for each."""

    def fail(*_: object) -> None:
        pytest.fail(f"does not end within {HANG_S} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(HANG_S)
    yield lambda: signal.alarm(HANG_S)
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)
