"""pycolmap. All other modules import it from here.

Importing pycolmap installs signal handlers, also for SIGTERM: the process would print a stack
trace, end at once, and leave its temporary files. This module restores the handlers that were there
before, and turns off pycolmap's log.
"""

import signal
from contextlib import suppress

_before = {n: signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)}

import pycolmap  # noqa: E402

for _number, _handler in _before.items():
    with suppress(ValueError):  # only the main thread may set handlers
        if _handler is not None:
            signal.signal(_number, _handler)

# Errors are raised; the log would also be printed, and left in temporary files.
pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
pycolmap.logging.logtostderr = True

__all__ = ["pycolmap"]
