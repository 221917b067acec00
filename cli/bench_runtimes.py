"""`dgc-pose bench-runtimes`: whether ONNX Runtime and torch give the same answers."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

from dgc_pose.benchmarks.runtimes import differences, row, summary
from dgc_pose.cli.bench_run import limit_option, listed_pairs, root_option
from dgc_pose.cli.guard import OutputFile
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.matching import DEFAULT_WEIGHTS


@click.command()
@click.argument("pair_list", metavar="LIST")
@root_option
@limit_option
@click.option("--weights", default=DEFAULT_WEIGHTS, show_default=True, help="Name or path.")
@click.option(
    "--json",
    "json_path",
    type=OutputFile("json"),
    metavar="PATH",
    help="Write the differences of all pairs as JSON.",
)
def bench_runtimes(
    pair_list: str, root: str | None, limit: int | None, weights: str, json_path: str | None
) -> None:
    """Compare ONNX Runtime and torch on the pairs of LIST, in SuperGlue's format.

    Prints for each pair how far apart the maps and the poses are, then medians and largest values.
    """
    pairs = listed_pairs(pair_list, root, limit).pairs
    images = (path for pair in pairs for path in (pair.path1, pair.path2))
    with staged(json_path, inputs=images) as stage:
        found = []
        for one in differences(weights, pairs):
            found.append(one)
            click.echo(row(one))
        if json_path is not None:
            text = json.dumps([asdict(one) for one in found], indent=1) + "\n"
            save_text(stage(json_path), text)
    click.echo(summary(found))
