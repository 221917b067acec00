"""Warnings: ours as a line each, those of libraries not at all."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import click


class _Lines(logging.Handler):
    """`warning: MESSAGE` on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        click.echo(f"warning: {' '.join(record.getMessage().split())}", err=True)


@contextmanager
def plain_warnings(*, shown: bool) -> Iterator[None]:
    """Within the block our warnings are lines on stderr, and those of libraries are silent.

    shown: print the libraries' warnings as well, as Python does. So does PYTHONWARNINGS.
    """
    ours, handler = logging.getLogger("dgc_pose"), _Lines()
    silent = logging.getLogger("matplotlib")  # of a HOME that cannot be written, of fonts
    level, propagates = silent.level, ours.propagate
    with warnings.catch_warnings():
        ours.addHandler(handler)
        ours.propagate = False
        if not (shown or sys.warnoptions or "PYTHONWARNINGS" in os.environ):
            warnings.simplefilter("ignore")
            silent.setLevel(logging.ERROR)
        try:
            yield
        finally:
            ours.removeHandler(handler)
            ours.propagate = propagates
            silent.setLevel(level)
