"""`dgc-pose bench-hpatches`: dense maps scored on pairs with known homographies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import click

from dgc_pose.benchmarks.homographies import HomographyPair, find_pairs, load_pair
from dgc_pose.benchmarks.hpatches_lists import read_lists
from dgc_pose.benchmarks.map_report import (
    HEADING,
    Scores,
    figures_table,
    groups_of,
    groups_table,
    pairs_table,
    summaries,
)
from dgc_pose.benchmarks.map_run import Case
from dgc_pose.benchmarks.published import HPATCHES_AEPE, HPATCHES_JACCARD
from dgc_pose.cli.map_bench import MapBench, map_bench_options, reliability_lines

SEQUENCES = 59  # of a changing viewpoint in HPatches


@click.command()
@click.option("--root", required=True, metavar="DIR", help="Folder of the images.")
@click.option(
    "--lists",
    metavar="DIR",
    help="Folder of the DGC-Net authors' hpatches_1_2.csv to hpatches_1_6.csv: take their pairs.",
)
@map_bench_options
def bench_hpatches(root: str, lists: str | None, bench: MapBench) -> None:
    """Score the dense maps of networks on pairs of images that a known homography relates.

    The folder is looked through, and the folders right below it, for HPatches' viewpoint sequences
    (v_*/1.ppm, v_*/H_1_2), VGG's sets (img1.png, H1to2p) and annotated pairs (NAME_A.jpg,
    NAME_B.jpg, NAME_H.txt). Image 1 is the source. Networks run as they are, without the matcher's
    search over turned images.
    """
    found = find_pairs(root) if lists is None else read_lists(lists, root)
    nets = bench.load()
    with bench.files(nets) as stage:
        scores, worst = bench.run(_cases(found.pairs), len(found.pairs), nets)
        facts = {
            "root": root,
            "lists": lists,
            "sequences": len(_sequences(found.pairs)),
            "missing": list(found.missing),
            "published_aepe": HPATCHES_AEPE,
            "published_jaccard": HPATCHES_JACCARD,
        }
        bench.write(stage, scores, worst, facts)
    click.echo("\n\n".join(_report(scores, found.pairs)))
    if found.missing:
        click.echo(f"{len(found.missing)} pairs missing: {', '.join(found.missing)}", err=True)


def _cases(pairs: Sequence[HomographyPair]) -> Iterator[Case]:
    for pair in pairs:
        yield Case(pair.group, (pair.name,), load_pair(pair))


def _sequences(pairs: Sequence[HomographyPair]) -> set[str]:
    return {pair.path1.parent.name for pair in pairs if pair.group}


def _report(scores: Scores, pairs: Sequence[HomographyPair]) -> Iterator[str]:
    yield HEADING
    if groups_of(scores):
        yield (
            f"AEPE by viewpoint, {len(_sequences(pairs))} of HPatches' {SEQUENCES} sequences\n"
            + groups_table(scores, "aepe", 2, HPATCHES_AEPE)
        )
        yield "Jaccard by viewpoint\n" + groups_table(scores, "jaccard", 3, HPATCHES_JACCARD)
    if not all(pair.group for pair in pairs):
        yield "AEPE of each pair\n" + pairs_table(scores)
    yield figures_table(summaries(scores))
    yield from reliability_lines(scores)
