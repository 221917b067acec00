"""Output of C libraries on stderr while they decode, kept from the user's terminal."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.Lock()  # the descriptor belongs to the whole process
_STDERR = 2


@contextmanager
def quiet() -> Iterator[None]:
    """Discard what is written to the process's standard error within the block.

    OpenCV, libpng and libjpeg print several lines for a corrupt file, past Python's sys.stderr. One
    thread at a time; what other threads print meanwhile is lost, so the block should be short.
    """
    with _lock:
        try:
            terminal = os.dup(_STDERR)
        except OSError:  # the process has no stderr
            yield
            return
        try:
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), _STDERR)
            yield
        finally:
            os.dup2(terminal, _STDERR)
            os.close(terminal)
