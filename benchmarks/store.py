"""A run on disk, as JSON Lines: its settings, then each piece of work as soon as it is done."""

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
    """The work that is done, and a function that puts the next piece on disk and among it.

    Raises InputError if another run is writing there, if the run that is gone on with had other
    settings, or if the file is none of a run.

    Args:
        path: the file, whose folder is made if missing; None keeps the work in memory alone.
        settings: all that the work depends on; JSON, as each piece is. NaN and infinity may be in a
            piece.
        resume: go on with the run that is there, without a line that a kill cut short. Else the
            file is begun anew.
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
                        f"{path}: that run had {key} {json.dumps(before.get(key))}, not "
                        f"{json.dumps(value)}: the same options are needed to go on with it"
                    )
        write_text(path, "".join(json.dumps(line) + "\n" for line in (settings, *done)))

        def add(piece: Any) -> None:
            with naming_path(path), path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(piece) + "\n")
            done.append(piece)

        yield done, add


def read_run(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """The settings and the work of a run; nothing of a file that a kill cut short at once. Raises
    InputError for another file, OSError."""
    with read_as("a run", path):
        whole = read_bytes(path).rpartition(b"\n")[0].decode()
        settings, *done = [json.loads(line) for line in whole.splitlines()] or [{}]
        return dict(settings), done
