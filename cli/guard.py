"""What every sub-command gets: --debug, --overwrite, the check of its outputs, its flags in place
of the names of arguments in errors, and a help with its options in sections.

Outputs are parameters of the types `OutputFile` and `OutputFolder`; inputs are those of other paths
of click. Before the command runs: an output that exists is replaced with --overwrite alone, an
input never.
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
_COLUMN = 20  # characters of an option, in the help, beside its text; a longer one stands above it


class NamedPath(click.Path):
    """A path that is not empty: Path("") would be the working folder."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "":
            self.fail("a path is needed", param, ctx)
        return super().convert(value, param, ctx)


class OutputFile(click.Path):
    """A file that the command writes. stdout: or `-`, for stdout. picture: in a format of one."""

    def __init__(self, *, stdout: bool = False, picture: bool = False) -> None:
        super().__init__(readable=False)
        self.stdout, self.picture = stdout, picture

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
        """Raise InputError for results of a run that is neither resumed nor replaced."""
        resume = [value for name, value in context.params.items() if name.endswith("__resume")]
        files = (os.path.join(path, name) for name in self.results)
        there = next(filter(os.path.lexists, files), None)
        if there is not None and not (any(resume) or overwrites()):
            hint = "--resume continues that run, " if resume else ""
            raise InputError(f"{there} is there already: {hint}--overwrite replaces it")


class SectionedOption(click.Option):
    """An option that says in which section of the help it stands."""

    def __init__(self, *arguments: Any, section: Section, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.section = section


class GuardedCommand(click.Command):
    """A command that checks its outputs, names its flags in errors, and has sections of options."""

    def invoke(self, ctx: click.Context) -> Any:
        for parameter in self.params:
            value, kind = ctx.params.get(parameter.name or ""), parameter.type
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
            error.args = tuple(
                flags.get(part, part) if isinstance(part, ArgumentName) else part
                for part in error.args
            )
            flag = self._option_of(error.path, ctx)
            if flag is not None and flag not in str(error):
                error.args = (f"{flag}:", *error.args)
            raise
        except OSError as error:
            if (flag := self._option_of(error.filename, ctx)) is None:
                raise
            raise InputError(f"{flag}: {error.filename}: {error.strerror}") from error

    def _option_of(self, path: Any, ctx: click.Context) -> str | None:
        """The option that alone was given this path; None if there is none."""
        given = []
        for parameter in self.params:
            value = ctx.params.get(parameter.name or "")
            for one in value if isinstance(value, tuple) else (value,):
                is_path = isinstance(one, str | Path) and one not in (STDOUT, parameter.default)
                if is_path and path is not None and Path(one) == Path(path):
                    given.append(parameter)
        return given[0].opts[0] if len(given) == 1 and isinstance(given[0], click.Option) else None

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        options = [p for p in self.get_params(ctx) if isinstance(p, click.Option)]
        for section in get_args(Section):
            records = [o.get_help_record(ctx) for o in options if _section(o) == section]
            if shown := [(r[0].ljust(_COLUMN), r[1]) for r in records if r is not None]:
                with formatter.section(section.capitalize()):
                    formatter.write_dl(shown, col_max=_COLUMN)


def guarded(command: click.Command) -> click.Command:
    """The command with the options that all have, and its outputs checked before it runs."""
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
    """Whether the present command was given --overwrite."""
    return bool(click.get_current_context().meta.get("overwrite"))


def _flag(parameter: click.Parameter) -> str:
    """The name of a parameter as its user knows it: --K-size, FRAMES."""
    is_option = isinstance(parameter, click.Option)
    return parameter.opts[0] if is_option else parameter.human_readable_name.removesuffix("...")


def _section(option: click.Option) -> Section:
    if isinstance(option.type, OutputFile | OutputFolder):
        return "output"
    return getattr(option, "section", "options")


def _inputs(context: click.Context) -> Iterator[Any]:
    """The paths that the command names beside its outputs."""
    for parameter in context.command.params:
        value, kind = context.params.get(parameter.name or ""), parameter.type
        if isinstance(kind, click.Path) and not isinstance(kind, OutputFile | OutputFolder):
            yield from value if isinstance(value, tuple) else [value] if value else []
