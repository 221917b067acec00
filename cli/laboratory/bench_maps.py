"""`dgc-pose bench-maps`: dense maps scored on pairs with known maps."""

from dataclasses import dataclass
from pathlib import Path

import click
from tqdm import tqdm

from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.matchers import DEVICE_HELP
from dgc_pose.network.weights import shipped
from dgc_pose.system.files import replaced
from dgc_pose.system.options import option
from dgc_pose.system.texts import write_json


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
    out: Path | None = option(
        None,
        "Write pairs.csv, summary.json and pck.png there.",
        metavar="DIR",
        type=OutputFolder("summary.json", "pairs.csv", "pck.png", path_type=Path),
    )
    device: str = option("auto", DEVICE_HELP, metavar="NAME")


@click.command()
@dataclass_options(MapBenchOptions, "bench")
def bench_maps(bench: MapBenchOptions) -> None:
    """Score the dense maps of networks and other matchers on photographs of planes.

    Networks run by themselves, without the matcher's search over rotations.
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

    root, out = bench.homographies, bench.out
    pairs = find_homography_pairs(root)
    sequences = len({pair.path1.parent for pair in pairs if pair.group in VIEWPOINTS})
    names = shipped() if bench.methods is None else split_names(bench.methods)
    methods = load_map_methods(list(names), device=bench.device)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    scores: dict[str, list[MapScore]] = {name: [] for name in methods}
    for pair in tqdm(pairs, unit="pair", disable=None):
        loaded = load_pair(pair)
        for name, compare in methods.items():
            scores[name].append(score_map(name, pair.group, pair.name, compare(loaded)))
    if out is not None:
        data = {"root": str(root), "sequences": sequences, **report_data(scores)}
        write_json(out / "summary.json", data)
        rows = [finite_data(score.data) for of_method in scores.values() for score in of_method]
        write_rows(out / "pairs.csv", rows)
        with replaced(out / "pck.png") as file:
            save_figure(plot_pck(scores), file)
    title = f"{len(pairs)} pairs of {root}, {sequences} of HPatches' {SEQUENCES} sequences"
    click.echo(f"{title}\n\n{report_text(scores)}")
