"""`dgc-pose bench-maps`: score dense maps on pairs with known maps."""

from dataclasses import dataclass
from pathlib import Path

import click
from tqdm import tqdm

from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.matchers import DEVICE_HELP
from dgc_pose.network.weights import shipped
from dgc_pose.system.files import save_text, staged
from dgc_pose.system.options import option
from dgc_pose.system.texts import json_text

_FILES = ("summary.json", "pairs.csv", "pck.png")


@dataclass(frozen=True)
class MapBenchOptions:
    """The pairs, the methods scored on them, and the files to write."""

    homographies: Path = option(
        help="Folder of photographs of planes, in it or right below: HPatches' viewpoint sequences "
        "(v_*/1.ppm, v_*/H_1_2), VGG's sets (img1.png, H1to2p), annotated pairs (NAME_A.jpg, "
        "NAME_B.jpg, NAME_H.txt). Image 1 is the source.",
        metavar="DIR",
    )
    methods: str | None = option(
        None,
        "Comma-separated names or paths of weights, or of other matchers with a dense map, as dis; "
        "default: all shipped weights.",
    )
    out: Path | None = option(
        None,
        "Write pairs.csv, summary.json and pck.png there.",
        metavar="DIR",
        type=OutputFolder(*_FILES, path_type=Path),
    )
    device: str = option("auto", DEVICE_HELP, metavar="NAME")


@click.command()
@dataclass_options(MapBenchOptions, "bench")
def bench_maps(bench: MapBenchOptions) -> None:
    """Score the dense maps of networks and other matchers on photographs of planes.

    Networks run without the matcher's search over rotations.
    """
    from dgc_pose.benchmarks.maps import (
        SEQUENCES,
        VIEWPOINTS,
        MapScore,
        find_homography_pairs,
        load_map_methods,
        load_pair,
        plot_pck,
        report_data,
        report_text,
        score_map,
    )
    from dgc_pose.benchmarks.report import finite_data, split_names, write_rows
    from dgc_pose.viz import save_figure

    root = bench.homographies
    out = bench.out
    pairs = find_homography_pairs(root)
    sequences = len({pair.path1.parent for pair in pairs if pair.group in VIEWPOINTS})
    names = shipped() if bench.methods is None else split_names(bench.methods)
    methods = load_map_methods(list(names), device=bench.device)
    paths = []
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        paths = [str(out / name) for name in _FILES]
    # Outputs are opened first: one that cannot be written stops the run before it begins.
    with staged(*paths) as stage:
        scores: dict[str, list[MapScore]] = {name: [] for name in methods}
        for pair in tqdm(pairs, unit="pair", disable=None):
            loaded = load_pair(pair)
            for name, compare in methods.items():
                scores[name].append(score_map(name, pair.group, pair.name, compare(loaded)))
        if paths:
            summary, table, figure = map(stage, paths)
            data = {"root": str(root), "sequences": sequences, **report_data(scores)}
            save_text(summary, json_text(data))
            each = [score for own in scores.values() for score in own]
            write_rows(table, [finite_data(score.data) for score in each])
            save_figure(plot_pck(scores), figure)
    title = f"{len(pairs)} pairs of {root}, {sequences} of HPatches' {SEQUENCES} sequences"
    click.echo(f"{title}\n\n{report_text(scores)}")
