"""`dgc-pose bench-synthetic`: dense maps scored on fixed sets of synthetic pairs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import click

from dgc_pose.benchmarks.map_report import (
    HEADING,
    Scores,
    figures_table,
    groups_of,
    summaries,
)
from dgc_pose.benchmarks.map_run import Case
from dgc_pose.benchmarks.published import SYNTHETIC
from dgc_pose.benchmarks.synthetic import PHOTO_SIDE, SETS, listed_cases, synthetic_cases
from dgc_pose.cli.map_bench import MapBench, map_bench_options, reliability_lines
from dgc_pose.cli.options import split_names
from dgc_pose.errors import InputError
from dgc_pose.synthesis.photos import load_held_back
from dgc_pose.synthesis.warp_lists import WarpList


@click.command()
@click.option(
    "--photos",
    required=True,
    metavar="DIR",
    help="Folder of photographs, as for training: only those that training holds back are used. "
    "With --list, the folder that its names are relative to.",
)
@click.option(
    "--list",
    "warp_list",
    metavar="CSV",
    help="The pairs of one of the DGC-Net authors' lists instead of the sets, all of them.",
)
@click.option(
    "--sets", default=",".join(SETS), show_default=True, help="Which sets, with commas between."
)
@click.option(
    "--pairs",
    type=click.IntRange(min=1),
    default=100,
    show_default=True,
    metavar="N",
    help="Pairs of each set.",
)
@click.option("--seed", default=0, show_default=True, help="The same seed, the same pairs.")
@click.option(
    "--changed",
    is_flag=True,
    help="With the trainer's changes of light, blur and noise, and with occluders before warped "
    "views; the paper's sets have none of these.",
)
@map_bench_options
def bench_synthetic(
    photos: str,
    warp_list: str | None,
    sets: str,
    pairs: int,
    seed: int,
    changed: bool,
    bench: MapBench,
) -> None:
    """Score the dense maps of networks on synthetic pairs with exact truth.

    Sets: affine, affine-tps (half of each) and homography by the paper's ranges, and scenes,
    ray-cast in 3D, whose cameras differ by 5 to 30 degrees.
    """
    if warp_list is None:
        source = _sets(photos, _checked(split_names(sets)), pairs, seed, changed)
    else:
        source = _listed(photos, warp_list)
    nets = bench.load()
    with bench.files(nets) as stage:
        scores, worst = bench.run(source.cases, source.total, nets)
        bench.write(stage, scores, worst, {**source.facts, "published": SYNTHETIC})
    click.echo("\n\n".join(_report(scores, source.about)))


@dataclass(frozen=True)
class _Source:
    """Where the pairs come from."""

    cases: Iterator[Case]
    total: int  # pairs
    about: str
    facts: Mapping[str, Any]


def _sets(photos: str, names: Sequence[str], pairs: int, seed: int, changed: bool) -> _Source:
    held_back = load_held_back(photos, PHOTO_SIDE)
    cases = chain.from_iterable(
        synthetic_cases(held_back, name, pairs, seed, changed=changed) for name in names
    )
    count = len(held_back.pixels)
    light = "with changes of light and occluders" if changed else "light as it is, no occluders"
    about = f"{count} photographs that training holds back, seed {seed}, {light}"
    facts = {"photographs": count, "seed": seed, "changed": changed}
    return _Source(cases, pairs * len(names), about, facts)


def _listed(photos: str, warp_list: str) -> _Source:
    rows = WarpList.read(warp_list).rows
    about = f"{len(rows)} pairs of {warp_list}"
    return _Source(listed_cases(rows, photos), len(rows), about, {"list": warp_list})


def _checked(names: Sequence[str]) -> list[str]:
    for name in names:
        if name not in SETS:
            raise InputError(f"no set '{name}'; there are {', '.join(SETS)}")
    if not names:
        raise InputError("no sets named")
    return list(dict.fromkeys(names))


def _report(scores: Scores, about: str) -> Iterator[str]:
    yield f"{about}\n{HEADING}"
    for group in groups_of(scores):
        yield figures_table(summaries(scores, group), first=group)
    yield SYNTHETIC
    yield from reliability_lines(scores)
