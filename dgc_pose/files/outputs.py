"""Output files that appear whole or not at all, and never in place of something else."""

from __future__ import annotations

import glob
import logging
import os
import platform
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal

from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_start

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

Kind = Literal["json", "npz", "png", "jpg", "webp", "tif", "svg", "pdf", "eps", "csv", "text", "db"]

# How the content of each kind of file begins; of csv and text see `holds`.
_STARTS: dict[str, tuple[bytes, ...]] = {
    "json": (b"{", b"["),
    "npz": (b"PK\x03\x04", b"PK\x05\x06"),
    "png": (b"\x89PNG",),
    "jpg": (b"\xff\xd8\xff",),
    "webp": (b"RIFF",),
    "tif": (b"II*\0", b"MM\0*"),
    "svg": (b"<?xml", b"<svg"),
    "pdf": (b"%PDF",),
    "eps": (b"%!PS",),
    "db": (b"SQLite format 3\0",),
}
_HOST = re.sub(r"\W", "-", platform.node())[:24]  # process numbers are those of one machine
_LONGEST = 180  # bytes of an output's name within that of its temporary file; 255 is the most
_log = logging.getLogger(__name__)


@contextmanager
def staged(
    *paths: str | None, inputs: Iterable[str | Path] = ()
) -> Iterator[Callable[[str], Path]]:
    """Open the output files of a command, so that one that cannot be written stops it at once.

    Yields a function from an output's path to a temporary file beside it, to write instead.
    When the block ends they replace the outputs. After an exception they are removed, and old
    outputs are untouched. Paths that are None are passed over. What a killed run left of the same
    outputs is removed, which is logged.

    Raises:
        InputError: if two outputs are the same file, one is a folder or a device, or one of the
            `inputs`.
        OSError: naming the output that cannot be written.
    """
    targets = {path: output_target(path) for path in paths if path is not None}
    if len(set(targets.values())) < len([path for path in paths if path is not None]):
        raise InputError("two outputs are the same file")
    require_no_input(targets, inputs)
    partial: dict[str, Path] = {}
    try:
        for path, target in targets.items():
            partial[path] = _create(path, target)
        yield partial.__getitem__
        for path, target in targets.items():
            os.replace(partial[path], target)
    except OSError as error:
        raise _named(error, partial) from None
    finally:
        for file in partial.values():
            with suppress(OSError):
                file.unlink(missing_ok=True)


def output_target(path: str | Path) -> Path:
    """The file that an output's path stands for, links followed.

    Raises InputError for the path of a folder or a device, for none, and for a loop of links.
    """
    text = os.fspath(path)
    is_folder = text.endswith(("/", os.sep)) or os.path.basename(text) in ("", ".", "..")
    if is_folder or "\0" in text or (os.path.exists(text) and not os.path.isfile(text)):
        raise InputError(f"an output must be a file, and {text!r} is something else")
    try:
        return Path(text).resolve()  # through a link to the file itself
    except (OSError, RuntimeError):
        raise InputError(f"{text}: a loop of links") from None


def require_no_input(outputs: Iterable[str | Path], inputs: Iterable[str | Path]) -> None:
    """Raise InputError if an output is one of the inputs: the same file, links followed."""
    read = {key: path for path in inputs if (key := _identity(path)) is not None}
    for output in outputs:
        key = _identity(output)
        if key is not None and key in read:
            same = f"the input {read[key]}" if str(read[key]) != str(output) else "an input"
            raise InputError(f"{output}: this output is {same}, which would be lost")


def require_kind(path: str | Path, kind: Kind) -> None:
    """Raise InputError if there is a file of another kind than the output that would replace it."""
    target = output_target(path)
    if target.is_file() and not holds(target, kind):
        raise InputError(
            f"{path} is there already and no file of this kind ({kind}): --overwrite replaces it"
        )


def holds(path: Path, kind: Kind) -> bool:
    """Whether a file begins as one of that kind does; an empty one does."""
    try:
        start = read_start(path, 4096)
    except OSError:  # not ours to replace
        return False
    if kind in _STARTS:
        return not start or start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(_STARTS[kind])
    first = start.partition(b"\n")[0]
    return not start or (b"\0" not in start and (kind == "text" or b"," in first))


def _identity(path: str | Path) -> tuple[int, int] | None:
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def _create(path: str, target: Path) -> Path:
    """An empty temporary file beside the target, which tells by its name who writes it."""
    stem = os.fsdecode(os.fsencode(target.name)[:_LONGEST])
    _clear(target, stem)
    file = target.with_name(f".{stem}.{_HOST}.{os.getpid()}.partial")
    try:
        file.open("xb").close()
    except OSError as error:
        raise OSError(error.errno, error.strerror, path) from None
    return file


def _clear(target: Path, stem: str) -> None:
    """Remove what killed runs on this machine left of an output, a file or a folder."""
    for left in sorted(target.parent.glob(f".{glob.escape(stem)}.{_HOST}.*.partial")):
        number = left.name.split(".")[-2]
        if number.isdecimal() and not _is_running(int(number)):
            with suppress(OSError):
                shutil.rmtree(left) if left.is_dir() and not left.is_symlink() else left.unlink()
                _log.warning("%s: removed, left by a run that has ended", left)


def _is_running(process: int) -> bool:
    """Whether another process of this number is there. This one has no such file yet."""
    if process == os.getpid():
        return False
    if os.name == "nt":  # where os.kill would end it
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # another user's
        return True
    return True


def _named(error: OSError, partial: dict[str, Path]) -> OSError:
    """The error with the output's path in place of the temporary one's."""
    for path, file in partial.items():
        if error.filename is not None and str(error.filename) == str(file):
            return OSError(error.errno, error.strerror, path)
    return error


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Around code that writes to this file alone: what the system says of no file is said of it."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def save_text(path: str | Path, text: str) -> None:
    """Write a text as UTF-8. Raises OSError, with the path."""
    with writing(path):
        Path(path).write_text(text, encoding="utf-8")


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A temporary file beside `path` that takes its place if the block ends without an error.

    An interrupted write leaves the old file whole.
    """
    with staged(str(path)) as stage:
        yield stage(str(path))


@contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place if the block ends without an error.

    What killed runs left of it is removed. The caller sees to it that the old folder may go.
    """
    _clear(path, path.name)
    new, old = (
        path.with_name(f".{path.name}.{_HOST}.{part}{os.getpid()}.partial") for part in ("", "old.")
    )
    new.mkdir()
    try:
        yield new
        if path.exists():
            os.replace(path, old)
        os.replace(new, path)
    finally:
        for left in (new, old):
            shutil.rmtree(left, ignore_errors=True)


def require_room(path: Path, size: int) -> None:
    """Raise OSError, with the path, unless so many bytes can be written beside it.

    For libraries that end the process, or say nothing, when a disk is full.
    """
    try:
        with tempfile.TemporaryFile(dir=path.parent) as file:  # without a name: nothing is left
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, max(1, size))
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder for temporary files, which is removed in the end.

    What killed runs of this user on this machine left is removed too. A lock tells that a folder is
    in use, which is also seen where process numbers are not.
    """
    start = f"dgc-pose.{_HOST}."
    for left in sorted(Path(tempfile.gettempdir()).glob(f"{start}*")):
        number = left.name.removeprefix(start).partition(".")[0]
        if number.isdecimal() and _is_ours(left) and not _is_running(int(number)):
            with suppress(OSError, InputError), only_writer(left):
                shutil.rmtree(left)
    with tempfile.TemporaryDirectory(prefix=f"{start}{os.getpid()}.") as name:
        with only_writer(Path(name)):
            yield Path(name)


def _is_ours(path: Path) -> bool:
    """Whether this is a folder, not a link to one, of the present user."""
    try:
        status = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and hasattr(os, "getuid") and status.st_uid == os.getuid()


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Keep a folder of outputs to one process. Raises InputError if another one writes there."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{folder}: another run is writing there") from None
        yield
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raises what `staged` raises."""
    with staged(str(path)) as stage:
        save_text(stage(str(path)), text)
