"""Output files that appear whole or not at all."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from dgc_pose.errors import InputError


@contextmanager
def staged(*paths: str | None) -> Iterator[Callable[[str], Path]]:
    """Open the output files of a command, so that one that cannot be written stops it at once.

    Yields a function from an output's path to a temporary file beside it, to write instead.
    When the block ends they replace the outputs. After an exception they are removed, and old
    outputs are untouched. Paths that are None are passed over.

    Raises:
        InputError: if two outputs are the same file, or one is a folder or a device.
        OSError: naming the output that cannot be written.
    """
    targets = {path: _target(path) for path in paths if path is not None}
    if len(set(targets.values())) < len([path for path in paths if path is not None]):
        raise InputError("two outputs are the same file")
    partial: dict[str, Path] = {}
    try:
        for path, target in targets.items():
            partial[path] = _create(path, target)
        yield partial.__getitem__
        for path, target in targets.items():
            os.replace(partial[path], target)
    finally:
        for file in partial.values():
            file.unlink(missing_ok=True)


def _target(path: str) -> Path:
    if not path or (os.path.exists(path) and not os.path.isfile(path)):
        raise InputError(f"an output must be a file, and {path!r} is something else")
    return Path(path).resolve()  # through a link to the file itself


def _create(path: str, target: Path) -> Path:
    file = target.with_name(f".{target.name}.{os.getpid()}.partial")
    try:
        file.open("xb").close()
    except OSError as error:
        raise OSError(error.errno, error.strerror, path) from None
    return file


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A temporary file beside `path` that takes its place if the block ends without an error.

    An interrupted write leaves the old file whole.
    """
    temporary = path.with_name(path.name + ".part")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def finite_or_none(value: float | None) -> float | None:
    """The value as a float for JSON, which has no NaN and no infinity: None instead."""
    return None if value is None or not math.isfinite(value) else float(value)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raises what `staged` raises."""
    with staged(str(path)) as stage:
        stage(str(path)).write_text(text, encoding="utf-8")
