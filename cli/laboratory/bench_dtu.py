"""`dgc-pose bench-dtu`: the paper's experiment on relative pose, over a user's copy of DTU."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import click

from dgc_pose.benchmarks.dtu.dataset import Light, open_dataset
from dgc_pose.benchmarks.dtu.pair_lists import PAIRS, choose_pairs
from dgc_pose.benchmarks.dtu.view_pairs import listed_pair
from dgc_pose.benchmarks.files import split_names
from dgc_pose.benchmarks.methods import EVERYWHERE, parse_methods
from dgc_pose.benchmarks.posed_pairs import ListedPairs, require_images
from dgc_pose.benchmarks.stored_matches import FileMatcher, pair_files
from dgc_pose.benchmarks.summary import heading, summary_table
from dgc_pose.cameras.pair_list import write_pairs
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.laboratory.bench_run import (
    PAIRS as LIST,
)
from dgc_pose.cli.laboratory.bench_run import (
    RUN_FOLDER,
    RunChoice,
    run_bench,
)
from dgc_pose.cli.laboratory.dtu_pairs import LIGHT_HELP
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option

Protocol = Literal["paper", "native"]
PAPER_SIZE = (256, 256)  # width, height (Melekhov et al., section 4.4)
EVERY_MATCH = 2**31  # more than any map has cells


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(name) for name in split_names(text))
    except ValueError:
        raise InputError(f"--scenes takes numbers separated by commas, not {text!r}") from None


@dataclass(frozen=True)
class Experiment:
    """Which pairs, in which protocol, and where the results go."""

    root: str = option(help="Folder of DTU.", metavar="DIR")
    out: Path = option(
        help="Folder of the results; created if missing.", metavar="DIR", type=RUN_FOLDER
    )
    scenes: tuple[int, ...] | None = option(
        None, "Numbers of the scenes; default: all that are found.", metavar="N,N", parse=_numbers
    )
    light: Light = option("3", LIGHT_HELP)
    pairs: str = option(
        str(PAIRS), "Number of pairs to draw over all scenes, or a list of pairs.", metavar="N|FILE"
    )
    protocol: Protocol = option(
        "paper",
        "paper: images squared to 256x256, every match, the best of --runs RANSAC runs (the "
        "paper's: 5 of 1000 iterations), not refined; native: images as stored, an even subsample "
        "of the matches, matches and poses refined.",
    )


@click.command()
@dataclass_options(Experiment, "experiment")
@click.option(
    "--matches",
    multiple=True,
    metavar="NAME=DIR",
    help="Maps, flows or matches that another program computed, as scanN_VIEW1_VIEW2 with the "
    "ending .flo, .npz or .npy; a method of that name.",
)
@dataclass_options(RunChoice, "run")
@dataclass_options(MatcherOptions, "matcher", only=("matching",))
@dataclass_options(EstimationOptions, "estimation")
def bench_dtu(
    experiment: Experiment,
    matches: tuple[str, ...],
    run: RunChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Repeat the paper's experiment on relative camera pose over DTU.

    It is bench-pairs over a list of views, which DIR keeps as pairs.txt, with the true poses of
    DTU's calibration. `--seed` draws the pairs and the samples of RANSAC; `--refine` and
    `--max-matches` apply to the native protocol.
    """
    paper = experiment.protocol == "paper"
    if paper:
        matching = replace(matcher.matching, max_matches=EVERY_MATCH, aligned="none")
        matcher = replace(matcher, matching=matching)
        estimation = replace(estimation, refine=False)
    stored = _folders(matches)
    methods = parse_methods(split_names(run.methods), matcher, estimation, [*stored])
    light, scenes = experiment.light, experiment.scenes
    dataset = open_dataset(experiment.root, scenes=scenes, light=light)
    views = choose_pairs(dataset, experiment.pairs, seed=estimation.seed, scenes=scenes)
    listed = [listed_pair(dataset, view) for view in views]
    require_images(listed)
    keys = [(view.scene, view.view1, view.view2) for view in views]
    stems = {
        (str(pair.path1), str(pair.path2)): f"scan{scene}_{view1}_{view2}"
        for pair, (scene, view1, view2) in zip(listed, keys, strict=True)
    }
    files = {name: FileMatcher(name, pair_files(path, stems)) for name, path in stored.items()}
    missing = sum(scene.missing for scene in dataset.scenes)
    names = ", ".join(f"scan{number}" for number in dataset.left_out)
    click.echo(
        f"{len(dataset.scenes)} scenes, {missing} views left out without "
        f"an image or a calibration{f', and with fewer than two views {names}' if names else ''}\n"
        f"{len(views)} pairs, {experiment.protocol} protocol"
    )
    pairs = ListedPairs(listed, seeds=keys, size=PAPER_SIZE if paper else None)
    setting = {"protocol": experiment.protocol, "light": light}
    summaries = run_bench(pairs, methods, experiment.out, run, stored=files, data=setting)
    write_pairs(experiment.out / LIST, listed)
    click.echo(f"{heading(estimation)}\n{summary_table(summaries)}")


def _folders(matches: Sequence[str]) -> dict[str, Path]:
    """NAME=DIR, by name."""
    folders: dict[str, Path] = {}
    for text in matches:
        name, _, folder = text.partition("=")
        if not name or not folder or name.endswith(EVERYWHERE) or set(name) & set(",:"):
            raise InputError(
                f"--matches takes NAME=DIR, the name without comma, colon and {EVERYWHERE}, "
                f"not {text!r}"
            )
        if name in folders:
            raise InputError(f"--matches: {name} is given twice")
        folders[name] = Path(folder)
    return folders
