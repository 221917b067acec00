"""What every sub-command gets: --debug, --max-pixels, --overwrite, and the check of its outputs.

A command declares its outputs by the types `OutputFile` and `OutputFolder` of its options. All
other options and arguments that name a file are its inputs. The check runs before the command.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from dgc_pose.errors import InputError
from dgc_pose.files.outputs import Kind, output_target, require_kind, require_no_input

STDOUT = "-"
DEBUG, OVERWRITE = "--debug", "--overwrite"
MAX_PIXELS_VARIABLE = "DGC_POSE_MAX_PIXELS"  # see dgc_pose.images.image, which imports OpenCV
_PICTURES = {"jpeg": "jpg", "tiff": "tif"}  # kinds that are called by several endings


class OutputFile(click.ParamType):
    """The path of a file that the command writes; None of the kind is that of the path's ending.

    stdout: whether `-` stands for stdout.
    """

    name = "path"

    def __init__(self, kind: Kind | None, *, stdout: bool = False) -> None:
        self.kind = kind
        self.stdout = stdout

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Left to the shell."""
        return [CompletionItem(incomplete, type="file")]

    def check(self, path: str) -> None:
        """Raise InputError if the path is no file's, or another kind of file is there."""
        ending = Path(path).suffix.lower().lstrip(".")
        kind = self.kind or _PICTURES.get(ending, ending)
        require_kind(path, kind)  # type: ignore[arg-type]


class OutputFolder(click.ParamType):
    """The folder of a command's files. names: of those that a new run does not replace."""

    name = "directory"

    def __init__(self, *names: str, path_type: type = str) -> None:
        self.names = names
        self.path_type = path_type

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Left to the shell."""
        return [CompletionItem(incomplete, type="dir")]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not os.fspath(value):  # Path("") would be the working folder
            raise click.BadParameter("the folder of the results needs a name", ctx, param)
        return self.path_type(value)

    def check(self, path: str, *, names: Sequence[str], resumes: bool) -> None:
        """Raise InputError if the path is no folder's, or there are results of a run."""
        if os.path.exists(path) and not os.path.isdir(path):
            raise InputError(f"{path}: the results need a folder, and this is none")
        for name in names:
            if os.path.lexists(os.path.join(path, name)):
                hint = "--resume goes on with that run, " if resumes else ""
                raise InputError(
                    f"{os.path.join(path, name)} is there already: {hint}--overwrite replaces it"
                )


def guarded(command: click.Command) -> click.Command:
    """The command with the options that all have, and its outputs checked before it runs."""
    if any(DEBUG in parameter.opts for parameter in command.params):
        return command  # guarded already: click asks for a command more than once
    command.params += [
        click.Option(
            ["--max-pixels"],
            type=click.IntRange(1, 2**30),
            metavar="N",
            expose_value=False,
            callback=_keep("max_pixels"),
            help="Most pixels of an image that is decoded; default: 210 million.",
        ),
        click.Option(
            [DEBUG],
            is_flag=True,
            expose_value=False,
            help="Show the trace of an error.",
        ),
    ]
    own = any(OVERWRITE in parameter.opts for parameter in command.params)
    if not own and any(_replaces(parameter.type) for parameter in command.params):
        command.params.append(
            click.Option(
                [OVERWRITE],
                is_flag=True,
                expose_value=False,
                callback=_keep("overwrite"),
                help="Replace files of another kind, and the results of an earlier run.",
            )
        )
    run = command.callback
    assert run is not None

    @functools.wraps(run)
    def checked(*args: Any, **kwargs: Any) -> Any:
        context = click.get_current_context()
        _check_outputs(context)
        with _environment(MAX_PIXELS_VARIABLE, context.meta.get(_key("max_pixels"))):
            return run(*args, **kwargs)

    command.callback = checked
    return command


def _replaces(kind: click.ParamType) -> bool:
    return isinstance(kind, OutputFile) or (isinstance(kind, OutputFolder) and bool(kind.names))


def overwrites() -> bool:
    """Whether the present command was given --overwrite."""
    return bool(click.get_current_context().meta.get(_key("overwrite")))


def _key(name: str) -> str:
    return f"{__name__}.{name}"


def _keep(name: str) -> Any:
    def keep(context: click.Context, parameter: click.Parameter, value: Any) -> None:
        context.meta[_key(name)] = value

    return keep


def _check_outputs(context: click.Context) -> None:
    """Raise InputError, naming the option, for an output that would destroy something."""
    values = [
        (parameter, context.params.get(parameter.name or ""))
        for parameter in context.command.params
    ]
    inputs = [
        path
        for parameter, value in values
        if not isinstance(parameter.type, OutputFile | OutputFolder)
        for path in _files(value)
    ]
    resumes = {name.rpartition("__")[2]: value for name, value in context.params.items()}
    for parameter, value in values:
        kind = parameter.type
        if value is None or not isinstance(kind, OutputFile | OutputFolder):
            continue
        path = os.fspath(value)
        try:
            if isinstance(kind, OutputFolder):
                fresh = overwrites() or resumes.get("resume")
                kind.check(path, names=() if fresh else kind.names, resumes="resume" in resumes)
            elif path != STDOUT:
                output_target(path)
                require_no_input([path], inputs)
                if not overwrites():
                    kind.check(path)
            elif not kind.stdout:
                raise InputError("only --json goes to stdout; a file called - is ./-")
        except InputError as error:
            raise InputError(f"{_label(parameter)}: {error}") from None


def _label(parameter: click.Parameter) -> str:
    if isinstance(parameter, click.Argument):
        return parameter.make_metavar(click.get_current_context())
    return max(parameter.opts, key=len)


def _files(value: Any) -> Iterator[str]:
    """The existing files that an option's value names: a path, or several in a text such as
    `NAME=PATH`, `PATH,PATH` or `PATH:option=value`."""
    if isinstance(value, tuple | list):
        for one in value:
            yield from _files(one)
    elif isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        parts = {text}
        for part in text.split(","):
            name = part.strip()
            parts |= {name, name.partition("=")[2], name.partition(":")[0].removesuffix("/all")}
        yield from filter(os.path.isfile, sorted(parts))


@contextmanager
def _environment(name: str, value: Any) -> Iterator[None]:
    """A variable of the environment within the block: it reaches worker processes too."""
    if value is None:
        yield
        return
    before = os.environ.get(name)
    os.environ[name] = str(value)
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
