"""`dgc-pose bench-hpatches`: dense maps scored on pairs with known homographies."""

import click

from dgc_pose.benchmarks.map_report import (
    HEADING,
    figures_table,
    groups_of,
    groups_table,
    pairs_table,
    reliability_lines,
    summaries,
)
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.laboratory.map_bench import MapBenchOptions, run_map_bench
from dgc_pose.cli.process import say

SEQUENCES = 59  # of a changing viewpoint in HPatches


@click.command()
@click.option("--root", required=True, metavar="DIR", help="Folder of the images.")
@dataclass_options(MapBenchOptions, "bench")
def bench_hpatches(root: str, bench: MapBenchOptions) -> None:
    """Score the dense maps of networks and other matchers on pairs with known homographies.

    Reads the folder and the folders right below it: HPatches' viewpoint sequences (v_*/1.ppm,
    v_*/H_1_2), VGG's sets (img1.png, H1to2p) and annotated pairs (NAME_A.jpg, NAME_B.jpg,
    NAME_H.txt). Image 1 is the source. Networks run by themselves, without the matcher's search
    over rotations.
    """
    from dgc_pose.benchmarks.homographies import (
        HPATCHES_AEPE,
        HPATCHES_JACCARD,
        find_homography_pairs,
    )
    from dgc_pose.benchmarks.map_run import MapSet

    data = find_homography_pairs(root)
    facts = {
        "root": root,
        "sequences": len(data.sequences),
        "missing": list(data.missing),
        "published_aepe": HPATCHES_AEPE,
        "published_jaccard": HPATCHES_JACCARD,
    }

    scores = run_map_bench(bench, MapSet(data.cases, len(data.pairs), facts))
    blocks = [HEADING]
    if groups_of(scores):
        viewpoints = f"AEPE by viewpoint, {len(data.sequences)} of HPatches' {SEQUENCES} sequences"
        blocks += [
            f"{viewpoints}\n{groups_table(scores, 'aepe', 2, HPATCHES_AEPE)}",
            f"Jaccard by viewpoint\n{groups_table(scores, 'jaccard', 3, HPATCHES_JACCARD)}",
        ]
    if not all(pair.group for pair in data.pairs):
        blocks.append(f"AEPE of each pair\n{pairs_table(scores)}")
    blocks += [figures_table(summaries(scores)), *reliability_lines(scores)]
    click.echo("\n\n".join(blocks))
    if data.missing:
        say(f"{len(data.missing)} pairs missing: {', '.join(data.missing)}")
