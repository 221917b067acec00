"""`dgc-pose bench-maps`: dense maps scored on pairs with known maps."""

import csv
from dataclasses import dataclass
from pathlib import Path

import click
from tqdm import tqdm

from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.matchers import DEVICE_HELP
from dgc_pose.network.weights import shipped
from dgc_pose.system.files import naming_path, save_text, staged
from dgc_pose.system.options import option
from dgc_pose.system.texts import json_text

_FILES = ("summary.json", "pairs.csv", "pck.png")


@dataclass(frozen=True)
class MapBenchOptions:
    """Which pairs, what is scored on them, and where the files go."""

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
    out: str | None = option(
        None,
        "Write pairs.csv, summary.json and pck.png there.",
        metavar="DIR",
        type=OutputFolder(*_FILES),
    )
    device: str = option("auto", DEVICE_HELP, metavar="NAME")


@click.command()
@dataclass_options(MapBenchOptions, "bench")
def bench_maps(bench: MapBenchOptions) -> None:
    """Score the dense maps of networks and other matchers on photographs of planes.

    Networks run by themselves, without the matcher's search over rotations.
    """
    from dgc_pose.benchmarks.maps import (
        HEADING,
        PCK_ALPHAS,
        SEQUENCES,
        VIEWPOINTS,
        MapScore,
        find_homography_pairs,
        groups_of,
        load_map_methods,
        load_pair,
        maps_table,
        pooled,
        reliability_lines,
        report_data,
        score_map,
    )
    from dgc_pose.benchmarks.report import finite_data, plot_pck, split_names
    from dgc_pose.viz import save_figure

    root = bench.homographies
    pairs = find_homography_pairs(root)
    sequences = len({pair.path1.parent for pair in pairs if pair.group in VIEWPOINTS})
    names = shipped() if bench.methods is None else split_names(bench.methods)
    methods = load_map_methods(list(names), device=bench.device)
    paths = {}
    if bench.out is not None:
        Path(bench.out).mkdir(parents=True, exist_ok=True)
        paths = {name: str(Path(bench.out, name)) for name in _FILES}
    # A file that cannot be written stops the run before it begins.
    with staged(*paths.values()) as stage:
        scores: dict[str, list[MapScore]] = {name: [] for name in methods}
        for pair in tqdm(pairs, unit="pair", disable=None):
            loaded = load_pair(pair)
            for name, compare in methods.items():
                scores[name].append(score_map(name, pair.group, pair.name, compare(loaded)))
        if paths:
            files = {name: stage(path) for name, path in paths.items()}
            data = {"root": str(root), "sequences": sequences, **report_data(scores)}
            save_text(files["summary.json"], json_text(data))
            rows = [finite_data(score.data) for of_method in scores.values() for score in of_method]
            table = files["pairs.csv"]
            with naming_path(table), table.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.DictWriter(stream, list(rows[0]))
                writer.writeheader()
                writer.writerows(rows)
            curves = {
                group: {
                    name: pooled(own, group).pck[: len(PCK_ALPHAS)] for name, own in scores.items()
                }
                for group in groups_of(scores)
            }
            save_figure(plot_pck(curves, PCK_ALPHAS), files["pck.png"])
    title = f"{len(pairs)} pairs of {root}, {sequences} of HPatches' {SEQUENCES} sequences"
    click.echo("\n\n".join([title, HEADING, maps_table(scores), *reliability_lines(scores)]))
