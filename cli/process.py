"""The process that a command runs in: its signals, standard streams and warnings."""

import logging
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import TextIOWrapper
from types import FrameType
from typing import Any, TextIO

import click

from dgc_pose.errors import InputError, printable
from dgc_pose.files.outputs import writing


class Stopped(BaseException):
    """A signal asked the process to end. Like KeyboardInterrupt no `Exception`."""

    @property
    def number(self) -> int:
        return int(self.args[0])


@contextmanager
def command_process(*, debug: bool) -> Iterator[None]:
    """Within the block SIGTERM and SIGHUP raise `Stopped`, unless they are ignored (nohup), so that
    a command that is stopped removes its partial files; an OSError of stdout names it; our warnings
    are lines on stderr.

    debug: print the libraries' warnings as well. Raises InputError if stdout or stderr is closed:
    the next file would get its number, and with it what libraries print.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            raise InputError(f"{name} is closed")
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="surrogateescape")  # as names of files are decoded
    stopping = (signal.SIGTERM, signal.SIGHUP)
    handled = [number for number in stopping if signal.getsignal(number) is signal.SIG_DFL]
    ours, handler = logging.getLogger("dgc_pose"), _Lines()
    matplotlib = logging.getLogger("matplotlib")  # of a HOME that cannot be written, of fonts
    with warnings.catch_warnings(), redirect_stdout(_Stdout(sys.stdout)):
        for number in handled:
            signal.signal(number, _stop)
        ours.addHandler(handler)
        ours.propagate = False
        if not debug:
            warnings.simplefilter("ignore")
            matplotlib.setLevel(logging.ERROR)
            os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")  # read when OpenCV is imported
        try:
            yield
        finally:
            matplotlib.setLevel(logging.NOTSET)
            ours.propagate = True
            ours.removeHandler(handler)
            for number in handled:
                signal.signal(number, signal.SIG_DFL)


def say(text: str) -> None:
    """Print a line on stderr, whatever the names in it hold."""
    click.echo(printable(text), err=True)


def _stop(number: int, frame: FrameType | None) -> None:
    signal.signal(number, signal.SIG_IGN)  # a second signal must not interrupt the removal
    raise Stopped(number)


class _Stdout:
    """A stream whose OSErrors name `stdout`."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with writing("stdout"):
            return self._stream.write(text)

    def flush(self) -> None:
        with writing("stdout"):
            self._stream.flush()


class _Lines(logging.Handler):
    """Prints `warning: MESSAGE` on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"warning: {record.getMessage()}")
