"""Common parts of bench-hpatches and bench-synthetic: options, the run, the files of --out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from dgc_pose.benchmarks.curves import plot_pck
from dgc_pose.benchmarks.files import split_names
from dgc_pose.benchmarks.map_report import (
    Scores,
    groups_of,
    report_data,
    summaries,
    write_pairs,
)
from dgc_pose.benchmarks.map_scores import ALL, PCK_ALPHAS, RIGHT_PX, PairScores
from dgc_pose.benchmarks.reliability import plot_reliability
from dgc_pose.cli.guard import OutputFile, OutputFolder
from dgc_pose.files.json_files import json_text
from dgc_pose.files.outputs import save_text, staged, writing
from dgc_pose.network.stored import shipped
from dgc_pose.runtime.load import DEVICE_HELP
from dgc_pose.system.options import option
from dgc_pose.viz import save_figure

if TYPE_CHECKING:
    from dgc_pose.benchmarks.map_run import MapSet

_FILES = ("summary.json", "pairs.csv", "pck.png", "reliability.png")


@dataclass(frozen=True)
class MapBenchOptions:
    """What to measure, how, and where the files go."""

    methods: str | None = option(
        None,
        "Comma-separated names or paths of weights, or of other matchers with a dense map, as "
        "dis; default: all shipped weights.",
    )
    out: str | None = option(
        None,
        "Write pairs.csv, summary.json, pck.png and reliability.png there.",
        metavar="DIR",
        type=OutputFolder(*_FILES),
    )
    json_path: str | None = option(
        None, "Write all figures as JSON.", flag="--json", metavar="PATH", type=OutputFile()
    )
    device: str = option("auto", DEVICE_HELP, metavar="NAME")


def run_map_bench(bench: MapBenchOptions, data: MapSet) -> Scores:
    """Score the methods on the data set, and write the files.

    Every output file is opened first: one that cannot be written stops the run before it begins.
    """
    from dgc_pose.benchmarks.map_run import load_map_methods, map_scores

    names = ",".join(shipped()) if bench.methods is None else bench.methods
    methods = load_map_methods(split_names(names), device=bench.device)
    paths = {}
    if bench.out is not None:
        Path(bench.out).mkdir(parents=True, exist_ok=True)
        paths = {name: str(Path(bench.out, name)) for name in _FILES}
    with staged(bench.json_path, *paths.values()) as stage:
        scores: dict[str, list[PairScores]] = {name: [] for name in methods}
        found = map_scores(data.cases, methods)
        total = data.total * len(methods)
        for pair in tqdm(found, total=total, unit="pair", disable=None):
            scores[pair.method].append(pair)
        text = json_text({**data.facts, **report_data(scores)})
        if bench.json_path is not None:
            save_text(stage(bench.json_path), text)
        if bench.out is not None:
            files = {name: stage(path) for name, path in paths.items()}
            save_text(files["summary.json"], text)
            _write_figures(files, scores)
    return scores


def _write_figures(files: Mapping[str, Path], scores: Scores) -> None:
    """The table of the pairs, the PCK curves by group, and the reliability diagram."""
    table = files["pairs.csv"]
    with writing(table), table.open("w", newline="", encoding="utf-8") as stream:
        write_pairs(stream, scores)
    curves = {
        group: {summary.method: summary.pck for summary in summaries(scores, group)}
        for group in groups_of(scores) or [ALL]
    }
    save_figure(plot_pck(curves, PCK_ALPHAS), files["pck.png"])
    masked = {
        summary.method: summary.reliability
        for summary in summaries(scores)
        if summary.reliability is not None
    }
    diagram = plot_reliability(masked, right=f"within {RIGHT_PX:g} px")
    save_figure(diagram, files["reliability.png"])
