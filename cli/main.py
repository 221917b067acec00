"""The command `dgc-pose`: its sub-commands, and the one place that prints their errors.

A sub-command's module is imported when it is called, so that `dgc-pose --help` is quick.
Exit codes: 0 done, 2 unusable input, 3 no pose (set by the sub-command).
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any, NoReturn

import click
from click.shell_completion import CompletionItem

from dgc_pose.errors import DgcPoseError

UNUSABLE_INPUT = 2
INTERRUPTED = 130  # what shells report after SIGINT
# Rounds that GNU's OpenMP, which torch uses on Linux, spins for a late thread before it sleeps. By
# default 300,000: a machine with another busy process then spends nearly all its time spinning.
SPIN_COUNT = "10000"


# By name, the line in the help. `some-name` is the function `some_name` of cli/some_name.py.
SUBCOMMANDS = {
    "estimate": "Estimate the relative pose of two photographs.",
    "match": "Match two photographs, no K needed.",
    "demo": "Estimate the pose of the bundled pair.",
    "batch": "Match many pairs: a folder, a list, a database.",
    "reconstruct": "From a folder of photographs to a COLMAP model.",
    "export-colmap": "Write a batch as a COLMAP database.",
    "bench-pairs": "Score methods on pairs with known poses.",
    "bench-hpatches": "Score maps on pairs with homographies.",
    "bench-synthetic": "Score maps on synthetic pairs.",
    "bench-dtu": "Repeat the paper's pose experiment on DTU.",
    "bench-verdicts": "Measure how far success can be trusted.",
    "fit-probability": "Fit the probability that a pose is right.",
    "bench-reconstruct": "Score reconstructions on known cameras.",
    "bench-estimators": "Compare the robust estimators.",
    "bench-speed": "Show where the time of a pair goes.",
    "dtu-pairs": "Make a pair list from DTU's calibration.",
    "train": "Train a network on photographs.",
    "info": "Show versions, weights, devices and threads.",
    "completion": "Print a shell's completion script.",
}


class LazyGroup(click.Group):
    """A group that imports a sub-command on its first use and reports errors in one line."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(SUBCOMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in SUBCOMMANDS:
            return None
        name = cmd_name.replace("-", "_")
        command = getattr(importlib.import_module(f"dgc_pose.cli.{name}"), name)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([*SUBCOMMANDS.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """As click's own, which would import every sub-command for its help."""
        commands = [
            CompletionItem(name, help=text)
            for name, text in SUBCOMMANDS.items()
            if name.startswith(incomplete)
        ]
        return commands + click.Command.shell_complete(self, ctx, incomplete)

    def main(self, *args: Any, **kwargs: Any) -> NoReturn:
        kwargs["standalone_mode"] = False
        try:
            status = super().main(*args, **kwargs)
        except click.Abort:
            _fail("interrupted", INTERRUPTED)
        except click.ClickException as error:
            _fail(error.format_message(), UNUSABLE_INPUT)
        except (OSError, DgcPoseError) as error:
            _fail(_describe(error), UNUSABLE_INPUT)
        sys.exit(status)


def _describe(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _fail(message: str, status: int) -> NoReturn:
    click.echo("error: " + " ".join(message.split()), err=True)
    sys.exit(status)


def _print_version(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:
        from dgc_pose.version import build, version

        click.echo(f"dgc-pose {version()} (build {build()})")
        ctx.exit()


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and the build, and exit.",
)
@click.pass_context
def main(ctx: click.Context) -> None:
    """Relative camera pose from two photographs.

    Exit codes: 0 success, 2 unusable input, 3 no pose (the reason is printed).
    """
    # Read when torch is imported, which no sub-command has done yet.
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", SPIN_COUNT)
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())
