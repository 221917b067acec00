"""`dgc-pose bench-maps`: dense maps scored on pairs with known maps."""

import csv
from dataclasses import dataclass
from pathlib import Path

import click
from tqdm import tqdm

from dgc_pose.benchmarks.files import finite_data, split_names
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.errors import InputError
from dgc_pose.files.json_files import json_text
from dgc_pose.files.outputs import save_text, staged, writing
from dgc_pose.matchers import DEVICE_HELP
from dgc_pose.network.weights import shipped
from dgc_pose.system.options import MAX_SEED, option

_FILES = ("summary.json", "pairs.csv", "pck.png")


@dataclass(frozen=True)
class MapBenchOptions:
    """Which pairs, what is scored on them, and where the files go."""

    homographies: str | None = option(
        None,
        "Folder of photographs of planes, in it or right below: HPatches' viewpoint sequences "
        "(v_*/1.ppm, v_*/H_1_2), VGG's sets (img1.png, H1to2p), annotated pairs (NAME_A.jpg, "
        "NAME_B.jpg, NAME_H.txt). Image 1 is the source.",
        metavar="DIR",
    )
    photos: str | None = option(
        None,
        "Folder of photographs, of which those that training holds back make synthetic pairs.",
        metavar="DIR",
    )
    sets: str = option(
        "affine,affine-tps,homography,scenes",
        "Comma-separated synthetic sets: warps by the paper's ranges (affine-tps: half of each), "
        "and scenes ray-cast in 3D, whose cameras differ by 5 to 30 degrees.",
    )
    pairs: int = option(100, "Pairs of each synthetic set.", metavar="N", min=1, max=10**6)
    seed: int = option(0, "The same seed, the same synthetic pairs.", min=0, max=MAX_SEED)
    changed: bool = option(
        False,
        "Synthetic pairs with the trainer's changes of light, blur and noise, and with occluders "
        "in warped views; the paper's sets have none of these.",
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
    """Score the dense maps of networks and other matchers on pairs with known maps.

    The pairs are photographs of planes (--homographies) or synthetic (--photos). Networks run by
    themselves, without the matcher's search over rotations.
    """
    from dgc_pose.benchmarks.homographies import homography_set
    from dgc_pose.benchmarks.map_run import load_map_methods, map_scores
    from dgc_pose.benchmarks.map_scores import (
        HEADING,
        PCK_ALPHAS,
        MapScore,
        groups_of,
        maps_table,
        pooled,
        reliability_lines,
        report_data,
    )
    from dgc_pose.benchmarks.synthetic import synthetic_set

    if bench.homographies is not None and bench.photos is None:
        data = homography_set(bench.homographies)
    elif bench.photos is not None and bench.homographies is None:
        sets = split_names(bench.sets)
        data = synthetic_set(bench.photos, sets, bench.pairs, bench.seed, changed=bench.changed)
    else:
        raise InputError("give --homographies or --photos, one of them")
    names = shipped() if bench.methods is None else split_names(bench.methods)
    methods = load_map_methods(list(names), device=bench.device)
    paths = {}
    if bench.out is not None:
        Path(bench.out).mkdir(parents=True, exist_ok=True)
        paths = {name: str(Path(bench.out, name)) for name in _FILES}
    # A file that cannot be written stops the run before it begins.
    with staged(*paths.values()) as stage:
        scores: dict[str, list[MapScore]] = {name: [] for name in methods}
        found, total = map_scores(data.cases, methods), data.total * len(methods)
        for pair in tqdm(found, total=total, unit="pair", disable=None):
            scores[pair.method].append(pair)
        if paths:
            from dgc_pose.benchmarks.curves import plot_pck
            from dgc_pose.viz import save_figure

            files = {name: stage(path) for name, path in paths.items()}
            save_text(files["summary.json"], json_text({**data.facts, **report_data(scores)}))
            rows = [finite_data(pair.data) for pairs in scores.values() for pair in pairs]
            table = files["pairs.csv"]
            with writing(table), table.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.DictWriter(stream, list(rows[0]))
                writer.writeheader()
                writer.writerows(rows)
            curves = {
                group: {name: pooled(pairs, group).pck for name, pairs in scores.items()}
                for group in groups_of(scores)
            }
            save_figure(plot_pck(curves, PCK_ALPHAS), files["pck.png"])
    click.echo("\n\n".join([data.title, HEADING, maps_table(scores), *reliability_lines(scores)]))
