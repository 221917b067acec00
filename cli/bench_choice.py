"""`dgc-pose bench-choice`: how many of the pairs that verify `--pairs auto:K` chooses."""

from __future__ import annotations

from pathlib import Path

import click

from dgc_pose.cli.options import split_names
from dgc_pose.errors import InputError
from dgc_pose.matching import DEFAULT_WEIGHTS


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--k", "numbers", default="6,8,10,12,16", show_default=True, help="Comma-separated values of K."
)
@click.option(
    "--weights",
    default=DEFAULT_WEIGHTS,
    show_default=True,
    help="Whose features are compared; other weights than those of the batch serve, too.",
)
def bench_choice(folder: Path, numbers: str, weights: str) -> None:
    """Compare `--pairs auto:K` with a finished batch over more pairs.

    DIR is the folder of a `dgc-pose batch`, best one over all pairs or over a random part of them.
    Prints for each K how many pairs are chosen, and how many of the batch's pairs with a pose (or
    a rotation) are among them. Nothing is matched.
    """
    from dgc_pose.batch.run import read_batch
    from dgc_pose.benchmarks.pair_recall import coarse_features, recall_table, recalls

    texts = split_names(numbers)
    if not texts or not all(text.isdecimal() and int(text) > 0 for text in texts):
        raise InputError(f"--k must be whole numbers of at least 1, not {numbers!r}")
    batch = read_batch(folder)
    features = coarse_features(batch, weights)
    click.echo(recall_table(recalls(batch, features, [int(text) for text in texts])))
