"""The command `dgc-pose`: its subcommands, and the one place where their errors are shown.

A subcommand's module is imported when it is called, so that `dgc-pose --help` is quick. Exit codes:
0 done, 2 unusable input, 3 no pose (set by the subcommand).
"""

from __future__ import annotations

import importlib
import os
import sys
from dataclasses import dataclass
from typing import Any, NoReturn

import click

from dgc_pose.errors import DgcPoseError

UNUSABLE_INPUT = 2
INTERRUPTED = 130  # what shells report after SIGINT
# Rounds that GNU's OpenMP, which torch uses on Linux, spins for a late thread before it sleeps. By
# default 300,000: a machine with another busy process then spends nearly all its time spinning.
SPIN_COUNT = "10000"


@dataclass(frozen=True)
class Subcommand:
    """The module and function of a subcommand, and its line in the help."""

    module: str
    attribute: str
    summary: str


SUBCOMMANDS = {
    "estimate": Subcommand(
        "dgc_pose.cli.estimate", "estimate", "Estimate the relative pose of two photographs."
    ),
    "match": Subcommand("dgc_pose.cli.match", "match", "Match two photographs, no K needed."),
    "demo": Subcommand("dgc_pose.cli.demo", "demo", "Estimate the pose of the bundled pair."),
    "bench-pairs": Subcommand(
        "dgc_pose.cli.bench_pairs", "bench_pairs", "Score methods on pairs with known poses."
    ),
    "bench-hpatches": Subcommand(
        "dgc_pose.cli.bench_hpatches", "bench_hpatches", "Score maps on pairs with homographies."
    ),
    "bench-synthetic": Subcommand(
        "dgc_pose.cli.bench_synthetic", "bench_synthetic", "Score maps on synthetic pairs."
    ),
    "bench-dtu": Subcommand(
        "dgc_pose.cli.bench_dtu", "bench_dtu", "Repeat the paper's pose experiment on DTU."
    ),
    "bench-verdicts": Subcommand(
        "dgc_pose.cli.bench_verdicts", "bench_verdicts", "Measure how far success can be trusted."
    ),
    "bench-estimators": Subcommand(
        "dgc_pose.cli.bench_estimators", "bench_estimators", "Compare the robust estimators."
    ),
    "bench-speed": Subcommand(
        "dgc_pose.cli.bench_speed", "bench_speed", "Show where the time of a pair goes."
    ),
    "dtu-pairs": Subcommand(
        "dgc_pose.cli.dtu_pairs", "dtu_pairs", "Make a pair list from DTU's calibration."
    ),
    "train": Subcommand("dgc_pose.cli.train", "train", "Train a network on photographs."),
}


class LazyGroup(click.Group):
    """A group that imports a subcommand on its first use and reports errors in one line."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(SUBCOMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        subcommand = SUBCOMMANDS.get(cmd_name)
        if subcommand is None:
            return None
        command = getattr(importlib.import_module(subcommand.module), subcommand.attribute)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, entry.summary) for name, entry in SUBCOMMANDS.items()])

    def main(self, *args: Any, **kwargs: Any) -> NoReturn:
        kwargs["standalone_mode"] = False
        try:
            status = super().main(*args, **kwargs)
        except click.Abort:
            _fail("interrupted", INTERRUPTED)
        except click.ClickException as error:
            _fail(error.format_message(), UNUSABLE_INPUT)
        except OSError as error:
            _fail(_describe(error), UNUSABLE_INPUT)
        except DgcPoseError as error:
            _fail(str(error), UNUSABLE_INPUT)
        sys.exit(status)


def _describe(error: OSError) -> str:
    if error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _fail(message: str, status: int) -> NoReturn:
    click.echo("error: " + " ".join(message.split()), err=True)
    sys.exit(status)


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(package_name="dgc-pose", prog_name="dgc-pose")
@click.pass_context
def main(ctx: click.Context) -> None:
    """Relative camera pose from two photographs.

    Exit codes: 0 success, 2 unusable input, 3 no pose (the reason is printed).
    """
    # Read when torch is imported, which no subcommand has done yet.
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", SPIN_COUNT)
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())
