"""Files: inputs that are checked; outputs that appear whole or not at all, never over an input.

For a damaged file a reader of NumPy, Pillow or torch raises almost anything, so a file is parsed
within `read_as`, which names it.
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

TEXT_BYTES = 2**26  # of a text file: a list of some 100,000 pairs
_START_BYTES = 4096  # of a text, which have no zero byte


@contextmanager
def naming_path(path: str | Path) -> Iterator[None]:
    """Around code that reads or writes this file alone: an OSError that names no file names it."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def open_file(path: str | Path, error: type[DgcPoseError] = InputError) -> BinaryIO:
    """A regular file to read, links followed.

    Raises `error`, with the path, for a folder, a pipe, which would wait for its writer, a device
    and no name of a file; OSError, with the path, if it cannot be opened.
    """
    with suppress(ValueError):  # a zero byte
        if os.path.isfile(path) or not os.path.exists(path):
            return open(path, "rb")
    raise error(Path(path), "is not a regular file")


def read_bytes(
    path: str | Path, limit: int = 2**31 - 1, error: type[DgcPoseError] = InputError
) -> bytes:
    """The content of a file. Raises as `open_file` does, and `error` for more than `limit` bytes;
    OSError, with the path, if it cannot be read."""
    with open_file(path, error) as stream, naming_path(path):
        size = os.fstat(stream.fileno()).st_size
        if size > limit:
            raise error(Path(path), f"is too large: {size} bytes, at most {limit} are read")
        return stream.read(size)


@contextmanager
def read_as(what: str, path: str | Path, error: type[DgcPoseError] = InputError) -> Iterator[None]:
    """Turn whatever a reader raises into `error`: "PATH is not `what` that can be read (why)".

    Our own errors and an OSError that names its file pass.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of readers, about what they repair
            yield
    except DgcPoseError:
        raise
    except MemoryError:
        raise error(Path(path), "needs more memory than there is") from None
    except Exception as failure:
        if isinstance(failure, OSError) and failure.filename is not None:
            raise
        why = f"is not {what} that can be read ({reason(failure)})"
        raise error(Path(path), why) from failure


def read_text(path: str | Path, what: str = "a text") -> str:
    """A text in UTF-8, without a byte order mark.

    Raises InputError, with the path, if it is no such text, has a zero byte near its beginning, as
    almost any other file has, or is not a regular file; OSError if it cannot be read.
    """
    data = read_bytes(path, TEXT_BYTES)
    with suppress(UnicodeDecodeError):
        if b"\0" not in data[:_START_BYTES]:
            return data.decode("utf-8-sig")
    raise InputError(Path(path), f"is not text, and {what} is")


@contextmanager
def staged(*paths: str | None) -> Iterator[Callable[[str], Path]]:
    """Open the output files of a command, before its work. Paths that are None are passed over.

    Yields a function from an output's path to the file to write instead, see `replaced`. Raises
    OSError, naming the output, if it cannot be written; InputError if two outputs are the same
    file, or one is a folder, a device, or written by another run.
    """
    outputs = [path for path in paths if path is not None]
    if len({output_target(path) for path in outputs}) < len(outputs):
        raise InputError("two outputs are the same file")
    with ExitStack() as stack:
        files = {path: stack.enter_context(replaced(path)) for path in outputs}
        yield files.__getitem__


@contextmanager
def replaced(path: str | Path) -> Iterator[Path]:
    """A file that takes the place of an output if the block ends without an error and wrote it.

    After an error or a kill the old file is whole. Raises as `staged` does.
    """
    target = output_target(path)
    with _workplace(target, path) as folder:
        file = folder / Path(path).name
        yield file
        if file.exists():
            os.replace(file, target)


@contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """As `replaced`, of a folder. The caller sees to it that the old folder may go."""
    with _workplace(path, path) as folder:
        new = folder / path.name
        new.mkdir()
        yield new
        if path.exists():
            os.replace(path, folder / f"{path.name}.old")
        os.replace(new, path)


@contextmanager
def _workplace(target: Path, path: str | Path) -> Iterator[Path]:
    """An empty folder beside an output, for this run alone, removed at the end.

    What a killed run left there is removed first. An OSError of a file in it names `path`, by which
    the user knows the output.
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
    """The file that an output's path stands for, links followed. Raises InputError for the path of
    a folder or a device, and for what is no path."""
    text = os.fspath(path)
    try:
        target = Path(text).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{text!r}: {error}") from None
    if text.endswith(("/", os.sep)) or (target.exists() and not target.is_file()):
        raise InputError(f"the output {text!r} is a folder or a device")
    return target


def require_no_input(outputs: Iterable[str | Path], inputs: Iterable[str | Path]) -> None:
    """Raise InputError if an output is one of the inputs: the same file, links followed."""
    present = [path for path in inputs if os.path.exists(path)]
    for output in filter(os.path.exists, outputs):
        for path in present:
            if os.path.samefile(path, output):
                same = f"the input {path}" if str(path) != str(output) else "an input"
                raise InputError(f"{output}: this output is {same}, which would be lost")


def save_text(path: str | Path, text: str) -> None:
    """Write a text as UTF-8. Raises OSError, with the path."""
    with naming_path(path):
        Path(path).write_text(text, encoding="utf-8")


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raises as `staged` does."""
    with replaced(path) as file:
        save_text(file, text)


def require_room(path: Path, size: int) -> None:
    """Raise OSError, with the path, unless so many bytes can be written beside it.

    For libraries that end the process, or say nothing, when a disk is full.
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
    """Keep a folder to one run. Raises InputError, naming the folder or the output that is written
    in it, if another run has it."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{output or folder}: another run is writing there") from None
        yield
    finally:
        os.close(descriptor)
