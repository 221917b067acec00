"""The command `dgc-pose`: its sub-commands, and the only place that prints their errors.

A sub-command's module is imported when it is called, so that `dgc-pose --help` is quick.
Exit codes: 0 success, 1 unexpected error, 2 unusable input, 3 no pose (set by the sub-command),
128 plus the signal's number if a signal stopped it.
"""

import importlib
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NoReturn

import click

from dgc_pose.cli.guard import DEBUG, guarded
from dgc_pose.cli.process import Stopped, command_process, to_stderr
from dgc_pose.errors import DgcPoseError, missing_package, reason, shortened

UNEXPECTED = 1
UNUSABLE_INPUT = 2
LONGEST = 1000  # characters of a message
# Rounds that a waiting thread of GNU OpenMP spins (torch uses it on Linux). With the default of
# 300,000, a machine with another busy process spends most of its time spinning.
SPIN_COUNT = "10000"

# By section of the help and by name, the line in the help. The command `some-name` is the function
# `some_name` in cli/some_name.py; benchmarks and training are in cli/laboratory/.
SECTIONS = {
    "Poses": {
        "estimate": "Estimate the relative pose of two photographs.",
        "moved": "Check whether a fixed camera has moved.",
        "demo": "Estimate the poses of the bundled pairs.",
        "serve": "Estimate poses on a page in the browser.",
    },
    "Many photographs": {
        "batch": "Match many pairs: a folder, a list, a database.",
        "judge": "Judge the matches of another program.",
        "reconstruct": "Make a COLMAP model from a folder of photographs.",
        "locate": "Place photographs in a model of known poses.",
        "rig": "Place fixed cameras in one frame.",
        "export-colmap": "Write a batch as a COLMAP database.",
        "export": "Write a COLMAP model for another tool.",
    },
    "Benchmarks": {
        "bench-dtu": "Repeat the paper's experiment on relative pose over DTU.",
        "bench-pairs": "Score methods on pairs with known poses.",
        "bench-maps": "Score maps on photographs of planes.",
        "bench-model": "Score reconstructions and locations on known cameras.",
    },
    "Training": {
        "train": "Train a network on photographs.",
        "fit-probability": "Fit the probability that a pose is right.",
        "fit-folders": "Fit the check of look-alike places in folders.",
    },
    "About": {"info": "Show versions, weights, devices and threads."},
}
SUBCOMMANDS = {name: text for section in SECTIONS.values() for name, text in section.items()}
LABORATORY = {*SECTIONS["Benchmarks"], *SECTIONS["Training"]}
# Files of the commands whose file has another name.
FILES = {"demo": "estimate", "export-colmap": "export", "fit-folders": "fit_probability"}


class LazyGroup(click.Group):
    """A group that imports a sub-command on its first use, and reports an error in one line."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(SUBCOMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in SUBCOMMANDS:
            return None
        file = FILES.get(cmd_name, cmd_name).replace("-", "_")
        folder = "dgc_pose.cli.laboratory" if cmd_name in LABORATORY else "dgc_pose.cli"
        module = importlib.import_module(f"{folder}.{file}")
        return guarded(getattr(module, cmd_name.replace("-", "_")))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        width = max(map(len, SUBCOMMANDS))
        for name, commands in SECTIONS.items():
            with formatter.section(name):
                formatter.write_dl([(name.ljust(width), text) for name, text in commands.items()])

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:  # click would print an extra empty line
            raise Stopped(signal.SIGINT) from None
        except BrokenPipeError:  # click would exit with 1
            raise Stopped(signal.SIGPIPE) from None

    def main(self, *args: Any, **kwargs: Any) -> NoReturn:
        kwargs["standalone_mode"] = False
        words = kwargs.get("args") or (args[0] if args else None) or sys.argv[1:]
        debug = DEBUG in words
        try:
            with command_process(debug=debug):
                status = super().main(*args, **kwargs)
                if sys.stdout is not None:  # None: the caller closed it
                    sys.stdout.flush()  # raises here, not at exit, if the disk is full
        except SystemExit:
            raise
        except BaseException as error:
            if debug:
                click.echo(traceback.format_exc(), err=True, nl=False)
            message, status = _message_and_status(error, words)
            if message is not None:
                to_stderr("error: " + shortened(" ".join(message.split()), LONGEST))
        sys.exit(status)


def _message_and_status(error: BaseException, words: Sequence[str]) -> tuple[str | None, int]:
    """The message of an error (None: print nothing) and the exit code."""
    match error:
        case click.Abort() | Stopped(number=signal.SIGINT):
            return "interrupted", 128 + signal.SIGINT
        case click.ClickException():
            return error.format_message(), UNUSABLE_INPUT
        case DgcPoseError():
            return str(error), UNUSABLE_INPUT
        case BrokenPipeError() | Stopped(number=signal.SIGPIPE):
            # The reader is gone, but Python would write the rest of the output at exit.
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return None, 128 + signal.SIGPIPE
        case Stopped():
            return f"stopped by {signal.Signals(error.number).name}", 128 + error.number
        case OSError():
            paths = [str(path) for path in (error.filename, error.filename2) if path is not None]
            parts = [" -> ".join(paths), error.strerror or reason(error)]
            return ": ".join(filter(None, parts)), UNUSABLE_INPUT
        case ModuleNotFoundError():
            # Options before the sub-command's name take no values, so the first word is the name.
            command = next((word for word in words if not word.startswith("-")), "this")
            if (missing := missing_package(error, command)) is not None:
                return missing, UNUSABLE_INPUT
        case MemoryError():
            return f"not enough memory: {reason(error)}", UNUSABLE_INPUT
    return f"{type(error).__name__}: {reason(error)} ({DEBUG} shows the trace)", UNEXPECTED


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option("--version", is_flag=True, help="Show the version and the build, and exit.")
@click.pass_context
def main(ctx: click.Context, version: bool) -> None:
    """Relative camera pose from two photographs.

    Exit codes: 0 success, 2 unusable input, 3 no pose (the reason is printed), 1 an
    unexpected error, 130 interrupted.
    """
    # torch reads it when imported, which happens later in the sub-commands.
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", SPIN_COUNT)
    # NumPy reads it when imported. Its products are small, and run in dgc-pose's own threads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # glibc reads it when a worker starts. With a heap per thread, a worker takes 10 % more memory.
    os.environ.setdefault("MALLOC_ARENA_MAX", "2")
    if version:
        from dgc_pose import version as versions

        click.echo(f"dgc-pose {versions.version()} (build {versions.build()})")
        ctx.exit()
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())
