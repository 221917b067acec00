"""`dgc-pose bench-verdicts`: whether a verdict and its expected error can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dgc_pose.benchmarks.methods import load_passes, parse_methods
from dgc_pose.benchmarks.verdicts import groups_table
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.laboratory.bench_run import RUN_FOLDER, RunChoice, open_store, work
from dgc_pose.matching import DEFAULT_WEIGHTS
from dgc_pose.system.options import MAX_SEED, option

if TYPE_CHECKING:
    from dgc_pose.benchmarks.verdict_pairs import Group


@dataclass(frozen=True)
class VerdictPairChoice:
    """Which pairs are judged."""

    photos: Path = option(
        help="Folder of photographs, as for training; those that training holds back are used."
    )
    scenes: tuple[Path, ...] = option(
        (),
        "Photographs of one scene; pairs of different folders are unrelated. At least two folders.",
        flag="--scene",
    )
    lists: tuple[str, ...] = option(
        (),
        "List of true pairs in SuperGlue's format, and the folder of its image paths.",
        flag="--list",
        metavar="LIST[,ROOT]",
    )
    limit: int | None = option(None, "Pairs of each list at most.", min=1, max=10**9)
    unrelated: int = option(200, "Unrelated pairs of photographs.", min=0, max=10**6)
    unrelated_scenes: int = option(
        100, "Unrelated pairs of the folders of --scene.", min=0, max=10**6
    )
    pairs: int = option(100, "Rendered true pairs.", min=0, max=10**6)
    misleading: int = option(10, "Misleading pairs of each kind.", min=0, max=10**6)
    seed: int = option(11, "The same seed, the same pairs.", min=0, max=MAX_SEED)

    def groups(self) -> list[Group]:
        """Unrelated and true pairs. Raises ImageError or InputError if they cannot be made."""
        from dgc_pose.benchmarks.verdict_pairs import (
            listed,
            rendered,
            unrelated_photos,
            unrelated_scenes,
        )

        groups = [unrelated_photos(self.photos, self.unrelated, self.seed)]
        if self.scenes:
            groups.append(unrelated_scenes(self.scenes, self.unrelated_scenes, self.seed))
        groups.append(rendered(self.photos, self.pairs, self.seed))
        for entry in self.lists:
            pair_list, _, root = entry.partition(",")
            groups.append(listed(Path(pair_list), Path(root) if root else None, self.limit))
        return groups


@click.command()
@dataclass_options(VerdictPairChoice, "choice")
@click.option(
    "--method", default=DEFAULT_WEIGHTS, show_default=True, help="One of --methods of bench-pairs."
)
@click.option(
    "--out",
    type=RUN_FOLDER,
    metavar="DIR",
    help="Write results.csv, each pair as soon as it is done.",
)
@dataclass_options(RunChoice, "run")
def bench_verdicts(choice: VerdictPairChoice, method: str, out: str | None, run: RunChoice) -> None:
    """Measure verdicts on unrelated pairs, true pairs, and pairs that mislead.

    Prints the verdicts on each kind of pair.
    """
    from dgc_pose.benchmarks.verdict_pairs import VerdictPairs, misleading

    methods = parse_methods([method])
    passes = load_passes(methods, device=run.device, runtime=run.runtime)
    groups = choice.groups()
    hard = misleading(choice.photos, choice.misleading, choice.seed)
    evaluation = run.evaluation(VerdictPairs([*groups, *hard]), methods, passes)
    scores = work(evaluation, open_store(evaluation, out, run))
    click.echo(groups_table(scores))
