"""pycolmap. Everything else imports it from here.

Its import sets handlers of signals, also of SIGTERM: a process would then print a stack trace and
end at once, and leave its temporary files. The handlers that were there before are set again, and
its log is turned off.
"""

import signal
from contextlib import suppress

_before = {n: signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)}

import pycolmap  # noqa: E402

for _number, _handler in _before.items():
    with suppress(ValueError):  # not in the main thread, which alone may do it
        if _handler is not None:
            signal.signal(_number, _handler)

# What goes wrong is raised: its log would be printed, and left in files among the temporary ones.
pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
pycolmap.logging.logtostderr = True

__all__ = ["pycolmap"]
