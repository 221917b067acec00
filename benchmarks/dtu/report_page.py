"""What a finished DTU run is shown by: its figures, the worst pairs, and report.html."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

from dgc_pose.benchmarks.dtu.entries import Entry
from dgc_pose.benchmarks.dtu.figures import by_method, plot_against_motion, plot_histograms
from dgc_pose.benchmarks.dtu.page_data import PairKey, data_uri, page_data
from dgc_pose.benchmarks.dtu.protocols import PairReader
from dgc_pose.benchmarks.dtu.records import DtuResult, DtuTiming
from dgc_pose.benchmarks.dtu.samples import method_file_name, read_sample
from dgc_pose.benchmarks.dtu.worst import plot_worst, worst_pairs
from dgc_pose.viz.figure import save_figure

PAGE = "report.html"
PICTURED = 300  # pairs with pictures in the page: more make a file that opens slowly
_TEMPLATES = Path(__file__).parent / "templates"
_CAPTIONS = {
    "rotation.svg": "Rotation error: share of pairs not above it",
    "translation.svg": "Translation error, 0 to 180 degrees: share of pairs not above it",
    "epipolar.svg": "Median symmetric epipolar distance of a pair: share of pairs not above it",
    "motion.png": "Errors against the true rotation and the baseline, with medians",
}


@dataclass(frozen=True)
class _Column:
    """A column of the page's table: `key` of a pair or of a result in the page's data."""

    key: str
    label: str
    title: str
    decimals: int = 0


_COLUMNS = (
    _Column("pair", "pair", "scene and views, in the order of the list"),
    _Column("rotation", "rotation°", "true rotation between the views, degrees", 1),
    _Column("baseline", "mm", "distance between the cameras, millimetres"),
    _Column("overlap", "overlap", "share of space at the object that both views see", 2),
    _Column("R", "R err°", "rotation error, degrees", 2),
    _Column("t", "t err°", "translation error, 0 to 180 degrees", 2),
    _Column("folded", "t folded°", "translation error e as min(e, 180 - e), degrees", 2),
    _Column("all", "D_e all", "median symmetric epipolar distance of all pixels, pixels", 2),
    _Column("confident", "D_e conf", "the same of the matches that the pose is from, pixels", 2),
    _Column("matches", "matches", "matches that the pose was estimated from"),
    _Column("inliers", "inliers", "matches that the estimated pose agrees with"),
    _Column("seconds", "pose s", "seconds to estimate the pose", 3),
    _Column("status", "status", "the estimator's verdict"),
)


def write_report(
    out: Path,
    entries: Sequence[Entry],
    rows: Sequence[DtuResult],
    timings: Sequence[DtuTiming],
    *,
    facts: Mapping[str, str],
    table: str,
    pictured: int = PICTURED,
) -> list[Path]:
    """Write all pictures of a finished run and its page into `out`; each appears whole.

    rotation, translation and epipolar as .png and .svg, motion.png, worst-METHOD.png for each
    method, and report.html, which needs none of the others.

    Args:
        out: the folder of the run, with the samples of matches that `write_sample` wrote.
        entries: the pairs, in the order of the list.
        rows: results of all methods, those of one method in the order of the entries.
        timings: of the same pairs and methods.
        facts: what was run, by name: protocol, data, estimator, seed and so on.
        table: the summary of the methods, as text.
        pictured: how many pairs the page shows with images and matches, at most.

    Returns the files written. Raises InputError without rows or for a sample that is none,
    ImageError for an image that cannot be read.
    """
    methods = by_method(rows)
    reader = PairReader(rows[0].protocol)
    with tempfile.TemporaryDirectory(dir=out, prefix=".report-") as name:
        folder = Path(name)
        for figure_name, figure in plot_histograms(rows).items():
            for kind in ("png", "svg"):
                save_figure(figure, folder / f"{figure_name}.{kind}", picture_format=kind)
        save_figure(plot_against_motion(rows), folder / "motion.png")
        known = {(one.scene, one.view1, one.view2): one for one in entries}
        for method, own in methods.items():
            path = folder / f"worst-{method_file_name(method)}.png"
            _write_worst(path, out, worst_pairs(own), known, reader)
        chosen = pictured_pairs(methods, pictured)
        data = page_data(out, entries, methods, timings, reader, chosen)
        page = _render(folder, data, len(chosen), facts, table)
        (folder / PAGE).write_text(page, encoding="utf-8")
        written = [out / file.name for file in sorted(folder.iterdir())]
        for path in written:
            os.replace(folder / path.name, path)
    return written


def pictured_pairs(
    methods: Mapping[str, Sequence[DtuResult]], count: int
) -> frozenset[PairKey]:
    """The pairs that the page has pictures of: the worst of each method, then from the start of
    the list, `count` of them where there are as many."""
    worst = [worst_pairs(own) for own in methods.values()]
    in_turn = [pairs[place] for place in range(max(map(len, worst))) for pairs in worst]
    in_order = [*in_turn, *next(iter(methods.values()))]
    return frozenset(list(dict.fromkeys(row.key[1:] for row in in_order))[:count])


def _write_worst(
    path: Path,
    out: Path,
    worst: Sequence[DtuResult],
    entries: Mapping[PairKey, Entry],
    reader: PairReader,
) -> None:
    shown = [reader.read(*row.key[1:], entries[row.key[1:]].pair) for row in worst]
    samples = [read_sample(out, row.key) for row in worst]
    save_figure(plot_worst(worst, shown, samples), path)


def _render(
    folder: Path,
    data: Mapping[str, Any],
    pictured: int,
    facts: Mapping[str, str],
    table: str,
) -> str:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(PAGE).render(
        title="Relative camera pose on DTU",
        facts=facts,
        table=table,
        plots=list(_plots(folder)),
        columns=_COLUMNS,
        data=data,
        pictured=pictured,
    )


def _plots(folder: Path) -> Iterable[Mapping[str, str]]:
    for name, caption in _CAPTIONS.items():
        kind = "image/svg+xml" if name.endswith(".svg") else "image/png"
        yield {"source": data_uri(kind, (folder / name).read_bytes()), "caption": caption}
