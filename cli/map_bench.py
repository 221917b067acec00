"""What bench-hpatches and bench-synthetic share: options, the run, and the files of --out."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from dgc_pose.benchmarks.map_report import (
    ALL,
    Scores,
    groups_of,
    reliability_line,
    report_data,
    summaries,
    write_pairs,
)
from dgc_pose.benchmarks.map_run import Case, Outcome, WorstPairs, run
from dgc_pose.benchmarks.methods import load_networks
from dgc_pose.cli.options import device_option, split_names
from dgc_pose.cli.output import json_text
from dgc_pose.evaluation.map_scores import PCK_ALPHAS, RIGHT_PX, PairScores, pooled_reliability
from dgc_pose.files import staged
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import shipped
from dgc_pose.viz import save_figure
from dgc_pose.viz.map_figure import MapPicture, plot_maps
from dgc_pose.viz.pck import plot_pck
from dgc_pose.viz.reliability import plot_reliability

Command = Callable[..., Any]


@dataclass(frozen=True)
class MapBench:
    """What to measure, how, and where the files go."""

    methods: str
    device: str
    per_axis: bool  # of the PCK curves
    worst: int  # pairs a method to draw
    out: str | None
    json_path: str | None

    def load(self) -> dict[str, DGCNet]:
        return load_networks(split_names(self.methods), device=self.device)

    @contextmanager
    def files(self, nets: Mapping[str, DGCNet]) -> Iterator[Callable[[str], Path]]:
        """Stage every file that a run writes: one that cannot be written stops it at once."""
        paths = [] if self.json_path is None else [self.json_path]
        if self.out is not None:
            Path(self.out).mkdir(parents=True, exist_ok=True)
            paths += [self._in_out(name) for name in (*_TABLES, *_worst_names(nets))]
        with staged(*paths) as stage:
            yield stage

    def run(
        self, cases: Iterable[Case], total: int, nets: Mapping[str, DGCNet]
    ) -> tuple[dict[str, list[PairScores]], WorstPairs]:
        """The scores by method, and the outcomes worth a picture."""
        scores: dict[str, list[PairScores]] = {name: [] for name in nets}
        worst = WorstPairs(self.worst if self.out is not None else 0)
        outcomes = run(cases, nets, self.per_axis)
        for outcome in tqdm(outcomes, total=total * len(nets), unit="pair", disable=None):
            scores[outcome.scores.method].append(outcome.scores)
            worst.add(outcome)
        return scores, worst

    def write(
        self,
        stage: Callable[[str], Path],
        scores: Scores,
        worst: WorstPairs,
        facts: Mapping[str, Any],
    ) -> None:
        """The summary as JSON, `facts` first; and in --out that, a row a pair, and the figures."""
        distance = "max of |dx|, |dy|" if self.per_axis else "Euclidean"
        data = json_text({**facts, "pck_distance": distance, **report_data(scores)})
        if self.json_path is not None:
            stage(self.json_path).write_text(data, encoding="utf-8")
        if self.out is None:
            return
        stage(self._in_out("summary.json")).write_text(data, encoding="utf-8")
        with stage(self._in_out("pairs.csv")).open("w", newline="", encoding="utf-8") as stream:
            write_pairs(stream, scores)
        curves = {
            group or ALL: {one.method: one.pck for one in summaries(scores, group)}
            for group in (groups_of(scores) or [None])
        }
        pck = plot_pck(curves, PCK_ALPHAS, distance=distance)
        save_figure(pck, stage(self._in_out("pck.png")))
        pooled = {method: pooled_reliability(own) for method, own in scores.items()}
        masked = {method: own for method, own in pooled.items() if own is not None}
        diagram = plot_reliability(masked, right=f"within {RIGHT_PX:g} px")
        save_figure(diagram, stage(self._in_out("reliability.png")))
        for method, name in zip(scores, _worst_names(scores), strict=True):
            pictures = [_picture(outcome) for outcome in worst.of(method)]
            if pictures:
                save_figure(plot_maps(pictures), stage(self._in_out(name)))

    def _in_out(self, name: str) -> str:
        return str(Path(self.out or "", name))


def map_bench_options(command: Command) -> Command:
    """--methods, --device, --per-axis, --worst, --out and --json, as `bench: MapBench`."""

    @click.option(
        "--methods",
        default=lambda: ",".join(shipped()),
        show_default="all shipped weights",
        help="Names or paths of weights, with commas between.",
    )
    @click.option(
        "--per-axis",
        is_flag=True,
        help="PCK curves of max(|dx|, |dy|), as the paper's authors count; else Euclidean.",
    )
    @click.option(
        "--worst",
        type=click.IntRange(min=1),
        default=4,
        show_default=True,
        metavar="N",
        help="Pairs a method to draw in --out, those of largest AEPE.",
    )
    @click.option(
        "--out",
        metavar="DIR",
        help="Write pairs.csv, summary.json, pck.png, reliability.png and worst_*.png there.",
    )
    @click.option("--json", "json_path", metavar="PATH", help="Write all figures as JSON.")
    @device_option
    @functools.wraps(command)
    def wrapper(
        *args: Any,
        methods: str,
        device: str,
        per_axis: bool,
        worst: int,
        out: str | None,
        json_path: str | None,
        **kwargs: Any,
    ) -> Any:
        bench = MapBench(methods, device, per_axis, worst, out, json_path)
        return command(*args, bench=bench, **kwargs)

    return wrapper


def reliability_lines(scores: Scores) -> list[str]:
    """A line for each method that has a mask."""
    pooled = {method: pooled_reliability(own) for method, own in scores.items()}
    return [reliability_line(method, own) for method, own in pooled.items() if own is not None]


_TABLES = ("summary.json", "pairs.csv", "pck.png", "reliability.png")


def _worst_names(methods: Iterable[str]) -> list[str]:
    """File names of the pictures: two methods may be files of one name in two folders."""
    return [f"worst_{n}_{Path(method).stem}.png" for n, method in enumerate(methods, start=1)]


def _picture(outcome: Outcome) -> MapPicture:
    scores, comparison = outcome.scores, outcome.comparison
    return MapPicture(
        title=f"{scores.name}, AEPE {scores.aepe:.2f}",
        image1=outcome.image1,
        image2=outcome.image2,
        map=comparison.finest.found,
        errors=comparison.errors,
    )
