"""What every sub-command gets: --debug, --max-pixels, --overwrite, the check of its outputs, its
flags in place of the names of arguments in errors, and a help with its options in sections.

Outputs are options of the types `OutputFile` and `OutputFolder`; all others may name inputs. Before
the command runs: an output that exists is replaced with --overwrite alone, an input never.
"""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import click

from dgc_pose.errors import ArgumentName, DgcPoseError, InputError
from dgc_pose.files.outputs import output_target, require_no_input
from dgc_pose.system.options import Section

STDOUT = "-"
DEBUG = "--debug"
MAX_PIXELS_VARIABLE = "DGC_POSE_MAX_PIXELS"  # see dgc_pose.images.image, which imports OpenCV
_COLUMN = 20  # characters of an option, in the help, beside its text; a longer one stands above it
# Between the parts of an option's value such as NAME=PATH, PATH,PATH or PATH/all:option=value.
_SEPARATOR = re.compile(r"\s*[,:=]\s*|/all\b")


class NamedPath(click.Path):
    """A path that is not empty: Path("") would be the working folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("a path is needed", param, ctx)
        return super().convert(value, param, ctx)


class OutputFile(click.Path):
    """A file that the command writes. stdout: or `-`, for stdout. picture: in a format of one."""

    def __init__(self, *, stdout: bool = False, picture: bool = False) -> None:
        super().__init__()
        self.stdout, self.picture = stdout, picture

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value  # `check` needs the other options

    def check(self, path: str, context: click.Context) -> None:
        """Raise InputError if the path is no file's, or a file's that is not to be replaced."""
        if path == STDOUT:
            if not self.stdout:
                raise InputError("only --json goes to stdout; a file called - is ./-")
            return
        if self.picture:
            from dgc_pose.viz.figure import picture_format  # slow to import

            picture_format(path)
        require_no_input([path], _inputs(context))
        if output_target(path).exists() and not overwrites():
            raise InputError(f"{path} is there already: --overwrite replaces it")


class OutputFolder(NamedPath):
    """The folder of a command's files. results: names of those that are not to be replaced."""

    def __init__(self, *results: str, path_type: type = str) -> None:
        super().__init__(file_okay=False, path_type=path_type)
        self.results = results

    def check(self, path: str | Path, context: click.Context) -> None:
        """Raise InputError if the folder has results of a run that is neither resumed nor
        replaced."""
        resume = {name.rpartition("__")[2]: value for name, value in context.params.items()}
        if resume.get("resume") or overwrites():
            return
        for file in (os.path.join(path, name) for name in self.results):
            if os.path.lexists(file):
                hint = "--resume continues that run, " if "resume" in resume else ""
                raise InputError(f"{file} is there already: {hint}--overwrite replaces it")


class SectionedOption(click.Option):
    """An option that says in which section of the help it stands."""

    def __init__(self, *arguments: Any, section: Section, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.section = section


class GuardedCommand(click.Command):
    """A command that checks its outputs, names its flags in errors, and has sections of options."""

    def invoke(self, ctx: click.Context) -> Any:
        _check_outputs(ctx)
        try:
            return super().invoke(ctx)
        except DgcPoseError as error:
            flags = _flags(self)
            error.args = tuple(
                flags.get(part, part) if isinstance(part, ArgumentName) else part
                for part in error.args
            )
            raise

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        options = [p for p in self.get_params(ctx) if isinstance(p, click.Option)]
        for section in get_args(Section):
            records = [o.get_help_record(ctx) for o in options if _section(o) == section]
            if shown := [(r[0].ljust(_COLUMN), r[1]) for r in records if r is not None]:
                with formatter.section(section.capitalize()):
                    formatter.write_dl(shown, col_max=_COLUMN)


def guarded(command: click.Command) -> click.Command:
    """The command with the options that all have, and its outputs checked before it runs."""
    params, hidden = list(command.params), {"expose_value": False}
    kinds = [parameter.type for parameter in params]
    if any(isinstance(kind, OutputFile) or getattr(kind, "results", ()) for kind in kinds):
        text = "Replace outputs that exist, but never an input."
        flag = SectionedOption(["--overwrite"], section="output", is_flag=True, help=text, **hidden)
        flag.callback = lambda context, _, value: context.meta.update({"overwrite": value})
        params.append(flag)
    text = "Most pixels of an image that is decoded; default: 210 million."
    most = SectionedOption(["--max-pixels"], section="advanced", metavar="N", help=text, **hidden)
    most.type, most.callback = click.IntRange(1, 2**30), _set_max_pixels
    params.append(most)
    text = "Show the trace of an error."
    params.append(SectionedOption([DEBUG], section="advanced", is_flag=True, help=text, **hidden))
    order = get_args(Section)
    params.sort(key=lambda p: order.index(_section(p)) if isinstance(p, click.Option) else -1)
    return GuardedCommand(command.name, callback=command.callback, params=params, help=command.help)


def overwrites() -> bool:
    """Whether the present command was given --overwrite."""
    return bool(click.get_current_context().meta.get("overwrite"))


def _section(option: click.Option) -> Section:
    if isinstance(option.type, OutputFile | OutputFolder):
        return "output"
    return option.section if isinstance(option, SectionedOption) else "options"


def _set_max_pixels(context: click.Context, parameter: click.Parameter, value: int | None) -> None:
    if value is not None:
        os.environ[MAX_PIXELS_VARIABLE] = str(value)  # reaches worker processes too
        context.call_on_close(lambda: os.environ.pop(MAX_PIXELS_VARIABLE))


def _flags(command: click.Command) -> dict[str, str]:
    """The command's flags by the library's names for them: those of fields, and those of arguments
    such as K_size."""
    flags = {}
    for option in command.params:
        if isinstance(option, click.Option):
            flag = option.opts[0]
            flags[flag.lstrip("-").replace("-", "_")] = flag
            flags[(option.name or "").rpartition("__")[2]] = flag
    return flags


def _check_outputs(context: click.Context) -> None:
    """Raise BadParameter, naming the option, for an output that would destroy something."""
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if value is not None and isinstance(parameter.type, OutputFile | OutputFolder):
            try:
                parameter.type.check(value, context)
            except InputError as error:
                raise click.BadParameter(str(error), context, parameter) from None


def _inputs(context: click.Context) -> Iterator[str]:
    """The files that the values of the other options and arguments may name."""
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if not isinstance(parameter.type, OutputFile | OutputFolder):
            for item in value if isinstance(value, tuple) else (value,):
                if isinstance(item, str | os.PathLike):
                    text = os.fspath(item)
                    yield from (text, *_SEPARATOR.split(text))
