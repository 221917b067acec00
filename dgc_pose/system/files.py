"""Files: checked inputs, and outputs that appear whole or not at all, never over an input.

NumPy, Pillow and torch raise almost any exception for a damaged file. Files are therefore parsed
within `read_as`, which names the file.
"""

import fcntl
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from dgc_pose.errors import DgcPoseError, InputError, reason

TEXT_BYTES = 2**26  # most bytes of a text file, enough for a list of some 100,000 pairs
_START_BYTES = 4096  # bytes at the start of a file, without a zero byte in a text


@contextmanager
def naming_path(path: str | Path) -> Iterator[None]:
    """Add the path to an OSError without one; for code that reads or writes only this file."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def open_file(path: str | Path, error: type[DgcPoseError] = InputError) -> BinaryIO:
    """Open a regular file to read, following links.

    Raises `error`, with the path, for a folder, a device, a pipe (which would wait for its writer)
    or an invalid file name; OSError, with the path, if the file cannot be opened.
    """
    with suppress(ValueError):  # a zero byte
        if os.path.isfile(path) or not os.path.exists(path):
            return open(path, "rb")
    raise error(Path(path), "is a folder" if os.path.isdir(path) else "is not a regular file")


def read_bytes(
    path: str | Path, limit: int = 2**31 - 1, error: type[DgcPoseError] = InputError
) -> bytes:
    """The content of a file. Raises as `open_file` does, and `error` for more than `limit` bytes;
    OSError, with the path, if it cannot be read."""
    with open_file(path, error) as stream, naming_path(path):
        size = os.fstat(stream.fileno()).st_size
        if size > limit:
            raise error(Path(path), f"is too large: {size} bytes, and the limit is {limit}")
        return stream.read(size)


@contextmanager
def read_as(what: str, path: str | Path, error: type[DgcPoseError] = InputError) -> Iterator[None]:
    """Turn whatever a reader raises into `error`: "PATH cannot be read as `what` (why)".

    Our own errors and an OSError that names its file stay as they are.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # readers warn about what they repair
            yield
    except DgcPoseError:
        raise
    except MemoryError:
        raise error(Path(path), "needs more memory than there is") from None
    except Exception as failure:
        if isinstance(failure, OSError) and failure.filename is not None:
            raise
        why = f"cannot be read as {what} ({reason(failure)})"
        raise error(Path(path), why) from failure


def read_text(path: str | Path, what: str = "a text") -> str:
    """The text of a UTF-8 file, without its byte order mark.

    Raises InputError, with the path, if the file is not regular or not UTF-8, or has a zero byte
    near its beginning, as almost all binary files have; OSError if it cannot be read.
    """
    data = read_bytes(path, TEXT_BYTES)
    with suppress(UnicodeDecodeError):
        if b"\0" not in data[:_START_BYTES]:
            return data.decode("utf-8-sig")
    raise InputError(Path(path), f"is not UTF-8 text; expected {what}")


@contextmanager
def staged(*paths: str | None) -> Iterator[Callable[[str], Path]]:
    """Open the output files of a command before its work. Skips paths that are None.

    Yields a function from an output's path to the file to write instead, see `replaced`. Raises
    OSError, naming the output, if it cannot be written; InputError if two outputs are the same
    file, or if an output is a folder, a device, or being written by another run.
    """
    outputs = [path for path in paths if path is not None]
    if len({output_target(path) for path in outputs}) < len(outputs):
        raise InputError("two outputs are the same file")
    with ExitStack() as stack:
        files = {path: stack.enter_context(replaced(path)) for path in outputs}
        yield files.__getitem__


@contextmanager
def replaced(path: str | Path) -> Iterator[Path]:
    """Yield a new file, which replaces an output if the block writes it and ends without an error.

    After an error or a kill the old file is unchanged. Raises as `staged` does.
    """
    target = output_target(path)
    with _workplace(target, path) as folder:
        file = folder / Path(path).name
        yield file
        if file.exists():
            os.replace(file, target)


@contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """As `replaced`, for a folder. The caller ensures that the old folder may be deleted."""
    with _workplace(path, path) as folder:
        new = folder / path.name
        new.mkdir()
        yield new
        if path.exists():
            os.replace(path, folder / f"{path.name}.old")
        os.replace(new, path)


@contextmanager
def _workplace(target: Path, path: str | Path) -> Iterator[Path]:
    """An empty folder beside an output, only for this run, removed at the end.

    Removes what a killed run left there. An OSError about a file in the folder names `path`
    instead, the name that the user gave the output.
    """
    folder = target.with_name(f".{target.name}.partial")
    try:
        if folder.exists():
            with only_writer(folder, path):
                shutil.rmtree(folder)
        folder.mkdir(exist_ok=True)
        with only_writer(folder, path):
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        if not str(error.filename).startswith(str(folder)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def output_target(path: str | Path) -> Path:
    """The file that the path of an output refers to, following links. Raises InputError if it is a
    folder or a device, or if the path is invalid."""
    text = os.fspath(path)
    try:
        target = Path(text).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{text!r}: {error}") from None
    if text.endswith(("/", os.sep)) or (target.exists() and not target.is_file()):
        raise InputError(f"the output {text!r} is a folder or a device")
    return target


def require_no_input(outputs: Iterable[str | Path], inputs: Iterable[str | Path]) -> None:
    """Raise InputError if an output is the same file as one of the inputs, following links."""
    present = [path for path in inputs if os.path.exists(path)]
    for output in filter(os.path.exists, outputs):
        for path in present:
            if os.path.samefile(path, output):
                same = f"the input {path}" if str(path) != str(output) else "an input"
                raise InputError(f"{output}: this output is {same}: choose another")


def save_text(path: str | Path, text: str) -> None:
    """Write a text as UTF-8. Raises OSError, with the path."""
    with naming_path(path):
        Path(path).write_text(text, encoding="utf-8")


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raises as `staged` does."""
    with replaced(path) as file:
        save_text(file, text)


def require_room(path: Path, size: int) -> None:
    """Raise OSError, with the path, unless `size` bytes can be written in its folder.

    For libraries that end the process, or raise no error, when a disk is full.
    """
    try:
        with tempfile.TemporaryFile(dir=path.parent) as file:
            os.posix_fallocate(file.fileno(), 0, max(1, size))
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder among the system's temporary files, removed at the end."""
    with tempfile.TemporaryDirectory(prefix="dgc-pose.") as name:
        yield Path(name)


@contextmanager
def only_writer(folder: Path, output: str | Path | None = None) -> Iterator[None]:
    """Lock a folder for this run. Raises InputError, naming `output` or else the folder, if another
    run has locked it."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{output or folder}: another run is writing it") from None
        yield
    finally:
        os.close(descriptor)
