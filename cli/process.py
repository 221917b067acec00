"""The process of a command: its signals, its lines on stderr, and its progress."""

import logging
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from io import TextIOWrapper
from types import FrameType
from typing import Any

import click

from dgc_pose.errors import InputError, missing, printable

INTERVAL_S = 60.0  # between the lines of progress in a log file


class Stopped(BaseException):
    """A signal that ends the process. Like KeyboardInterrupt, it is not an `Exception`."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def command_process(*, debug: bool) -> Iterator[None]:
    """Within the block, SIGTERM and SIGHUP raise `Stopped`, unless they are ignored (nohup). So a
    stopped command removes its partial files. Warnings of dgc_pose are lines on stderr.

    debug: whether to print warnings of libraries too.
    """
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="surrogateescape")  # like names of files
    logging.getLogger("dgc_pose").addHandler(_LINES)
    stopping = (signal.SIGTERM, signal.SIGHUP)
    handled = [number for number in stopping if signal.getsignal(number) is signal.SIG_DFL]
    with warnings.catch_warnings():
        if not debug:
            warnings.simplefilter("ignore")
            logging.getLogger("matplotlib").setLevel(logging.ERROR)  # on fonts, its folder
            os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")  # read when OpenCV is imported
        for number in handled:
            signal.signal(number, _stop)
        try:
            yield
        finally:
            for number in handled:
                signal.signal(number, signal.SIG_DFL)


def to_stderr(text: str) -> None:
    """Print one line on stderr, without control characters."""
    click.echo(printable(text), err=True)


def name_bad_images(bad: Mapping[str, str], names: Iterable[str]) -> None:
    """Print why images of a list are unusable, by name. Raises InputError if all `names` are."""
    reasons = [
        why if why.startswith((f"{name} ", f"{name}:")) else f"{name}: {why}"
        for name, why in bad.items()
    ]
    every = {*names, *bad}
    if len(bad) == len(every) == 1:
        raise InputError(*reasons)
    for text in reasons:
        to_stderr(f"bad image {text}")
    if len(bad) == len(every):
        raise InputError(f"none of the {len(every)} images can be used")


def name_missing_second() -> None:
    """Print how the second matcher is installed, if it is not."""
    if text := missing("a second matcher, for poses in doubt,", "lightglue"):
        to_stderr(text)


def _stop(number: int, frame: FrameType | None) -> None:
    signal.signal(number, signal.SIG_IGN)  # a second signal must not interrupt the clean-up
    raise Stopped(number)


class _Lines(logging.Handler):
    """Prints `warning: MESSAGE` on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        to_stderr(f"warning: {record.getMessage()}")


_LINES = _Lines()


@contextmanager
def progress_bars() -> Iterator[Callable[[str, int, int], None]]:
    """Show the progress of stages such as "images": a bar on a terminal, else a line per minute."""
    from tqdm import tqdm

    bars: dict[str, Any] = {}
    lines: dict[str, tuple[float, int, float]] = {}  # the stage's start, first number, last line

    def progress(stage: str, done: int, of: int) -> None:
        if stage not in bars:
            bar = tqdm(total=of, initial=done, unit=stage.removesuffix("s"), disable=None)
            bars[stage] = stack.enter_context(bar)
        bars[stage].update(done - bars[stage].n)
        now = time.monotonic()
        start, first, last = lines.setdefault(stage, (now, done, now))
        if bars[stage].disable and (now - last >= INTERVAL_S or (done == of and last > start)):
            minutes = (now - start) / max(1, done - first) * (of - done) / 60
            to_stderr(f"{stage} {done} of {of}, {100 * done / of:.0f} %, {minutes:.0f} min left")
            lines[stage] = start, first, now

    with ExitStack() as stack:
        yield progress
