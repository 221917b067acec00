"""A run on disk as JSON Lines: its settings, then each piece of work once it is done."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dgc_pose.errors import InputError
from dgc_pose.system.files import naming_path, only_writer, read_as, read_bytes, write_text


@contextmanager
def open_run(
    path: Path | None, settings: Mapping[str, Any], *, resume: bool = False
) -> Iterator[tuple[list[Any], Callable[[Any], None]]]:
    """The pieces of work done so far, and a function that adds a piece to them and to the file.

    Raises InputError if another process writes there, if the resumed run had other settings, or if
    the file is not a run.

    Args:
        path: the file, whose folder is made if missing; None keeps the work only in memory.
        settings: everything the work depends on, as JSON. Pieces are JSON too, and may contain NaN
            and infinity.
        resume: continue the run in the file, without a last line that a kill cut short. Otherwise
            the file is overwritten.
    """
    done: list[Any] = []
    if path is None:
        yield done, done.append
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with only_writer(path.parent):
        if resume and path.exists():
            before, done = read_run(path)
            for key, value in json.loads(json.dumps(settings)).items():
                if (before or done) and before.get(key) != value:
                    raise InputError(
                        f"{path}: that run has {key} {json.dumps(before.get(key))}, not "
                        f"{json.dumps(value)}: resume it with the same options"
                    )
        write_text(path, "".join(json.dumps(line) + "\n" for line in (settings, *done)))

        def add(piece: Any) -> None:
            with naming_path(path), path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(piece) + "\n")
            done.append(piece)

        yield done, add


def read_run(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """The settings and the work of a run; both are empty if a kill cut the first line short. Raises
    InputError if the file is not a run; OSError."""
    with read_as("a run", path):
        whole = read_bytes(path).rpartition(b"\n")[0].decode()
        settings, *done = [json.loads(line) for line in whole.splitlines()] or [{}]
        return dict(settings), done
