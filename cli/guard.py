"""Common parts of all sub-commands: --debug, --overwrite, a check of the outputs, errors that name
flags in place of arguments, and a help with options in sections.

Outputs are parameters of the types `OutputFile` and `OutputFolder`; parameters of other path types
are inputs. The check runs before the command: an existing output needs --overwrite, and an input is
never overwritten.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import click

from dgc_pose.errors import ArgumentName, DgcPoseError, InputError
from dgc_pose.system.files import output_target, require_no_input
from dgc_pose.system.options import Section

STDOUT = "-"
DEBUG = "--debug"
_COLUMN = 20  # width of the options' column in the help; a longer option is above its text


class NamedPath(click.Path):
    """A non-empty path: Path("") would be the working folder."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "":
            self.fail("a path is needed", param, ctx)
        return super().convert(value, param, ctx)


class OutputFile(click.Path):
    """A file that the command writes. stdout: `-` is allowed. picture: must be a picture format."""

    def __init__(self, *, stdout: bool = False, picture: bool = False) -> None:
        super().__init__(readable=False)
        self.stdout = stdout
        self.picture = picture

    def check(self, path: str, context: click.Context) -> None:
        """Raise InputError if the path cannot be a file, or is a file that must not be replaced."""
        if path == STDOUT:
            if not self.stdout:
                raise InputError("only --json goes to stdout; a file called - is ./-")
            return
        if self.picture:
            from dgc_pose.viz.figure import picture_format  # slow to import

            picture_format(path)
        require_no_input([path], _inputs(context))
        if output_target(path).exists() and not overwrites():
            raise InputError(f"{path} exists already: --overwrite replaces it")


class OutputFolder(NamedPath):
    """The folder of a command's files. results: files that are never replaced silently."""

    def __init__(self, *results: str, path_type: type = str) -> None:
        super().__init__(file_okay=False, path_type=path_type)
        self.results = results

    def check(self, path: str | Path, context: click.Context) -> None:
        """Raise InputError if there are results, and neither --resume nor --overwrite is given."""
        resume = [value for name, value in context.params.items() if name.endswith("__resume")]
        files = (os.path.join(path, name) for name in self.results)
        there = next(filter(os.path.lexists, files), None)
        if there is not None and not (any(resume) or overwrites()):
            hint = "--resume continues that run, " if resume else ""
            raise InputError(f"{there} exists already: {hint}--overwrite replaces it")


class SectionedOption(click.Option):
    """An option in a section of the help."""

    def __init__(self, *arguments: Any, section: Section, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.section = section


class GuardedCommand(click.Command):
    """A command that checks its outputs, names its flags in errors, and has sections of options."""

    def invoke(self, ctx: click.Context) -> Any:
        for parameter in self.params:
            value = ctx.params.get(parameter.name or "")
            kind = parameter.type
            if value is not None and isinstance(kind, OutputFile | OutputFolder):
                try:
                    kind.check(value, ctx)
                except InputError as error:
                    raise click.BadParameter(str(error), ctx, parameter) from None
        try:
            return super().invoke(ctx)
        except DgcPoseError as error:
            flags = {}  # by the field's name, and by the argument's, such as K_size
            for parameter in self.params:
                flags[parameter.opts[0].lstrip("-").replace("-", "_")] = _flag(parameter)
                flags[(parameter.name or "").rpartition("__")[2]] = _flag(parameter)
            is_named = any(isinstance(part, ArgumentName) and part in flags for part in error.args)
            error.args = tuple(
                flags.get(part, part) if isinstance(part, ArgumentName) else part
                for part in error.args
            )
            if not is_named and (flag := _option_of(error.path, ctx)) is not None:
                error.args = (f"{flag}:", *error.args)
            raise
        except OSError as error:
            if (flag := _option_of(error.filename, ctx)) is None:
                raise
            raise InputError(f"{flag}: {error.filename}: {error.strerror}") from error

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        options = [p for p in self.get_params(ctx) if isinstance(p, click.Option)]
        for section in get_args(Section):
            records = [o.get_help_record(ctx) for o in options if _section(o) == section]
            if shown := [(r[0].ljust(_COLUMN), r[1]) for r in records if r is not None]:
                with formatter.section(section.capitalize()):
                    formatter.write_dl(shown, col_max=_COLUMN)


def guarded(command: click.Command) -> click.Command:
    """The command with the common options, and with a check of its outputs before it runs."""
    params = list(command.params)
    if any(isinstance(p.type, OutputFile) or getattr(p.type, "results", ()) for p in params):
        flag = SectionedOption(["--overwrite"], section="output", expose_value=False, is_flag=True)
        flag.help = "Replace outputs that exist, but never an input."
        flag.callback = lambda context, _, value: context.meta.update({"overwrite": value})
        params.append(flag)
    trace = SectionedOption([DEBUG], section="advanced", expose_value=False, is_flag=True)
    trace.help = "Show the trace of an error."
    return GuardedCommand(
        command.name, callback=command.callback, params=[*params, trace], help=command.help
    )


def overwrites() -> bool:
    """Whether --overwrite was given to the current command."""
    return bool(click.get_current_context().meta.get("overwrite"))


def _flag(parameter: click.Parameter) -> str:
    """The name of a parameter on the command line: --K-size, FRAMES."""
    is_option = isinstance(parameter, click.Option)
    return parameter.opts[0] if is_option else parameter.human_readable_name.removesuffix("...")


def _section(option: click.Option) -> Section:
    if isinstance(option.type, OutputFile | OutputFolder):
        return "output"
    return getattr(option, "section", "options")


def _option_of(path: Any, context: click.Context) -> str | None:
    """The option whose value is this path; None if no option or more than one has it."""
    given = []
    for parameter, value in _given(context):
        is_stated = isinstance(value, str | Path) and value not in (STDOUT, parameter.default)
        if is_stated and path is not None and Path(value) == Path(path):
            given.append(parameter)
    return given[0].opts[0] if len(given) == 1 and isinstance(given[0], click.Option) else None


def _inputs(context: click.Context) -> Iterator[Any]:
    """The paths on the command line, without the outputs."""
    for parameter, value in _given(context):
        kind = parameter.type
        if isinstance(kind, click.Path) and not isinstance(kind, OutputFile | OutputFolder):
            yield value


def _given(context: click.Context) -> Iterator[tuple[click.Parameter, Any]]:
    """Each value on the command line, with its parameter; a parameter may have several values."""
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        for one in value if isinstance(value, tuple) else (value,):
            if one:
                yield parameter, one
