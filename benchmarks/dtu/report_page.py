"""The report of a finished DTU run: its figures, the worst pairs, and report.html."""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from dgc_pose.benchmarks.dtu.dtu_pairs import DtuPairs, ViewKey
from dgc_pose.benchmarks.dtu.page_data import data_uri, page_data
from dgc_pose.benchmarks.dtu.worst import plot_worst, worst_pairs
from dgc_pose.benchmarks.samples import method_file_name, read_sample
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.benchmarks.summary import by_method, columns
from dgc_pose.files.outputs import save_text
from dgc_pose.viz.figure import save_figure
from dgc_pose.viz.motion import plot_against_motion, plot_histograms

PAGE = "report.html"
PICTURED = 300  # pairs with pictures in the page: more make a file that opens slowly
_log = logging.getLogger(__name__)
_TEMPLATES = Path(__file__).parent / "templates"
_CAPTIONS = {
    "rotation.svg": "Rotation error: share of pairs not above it",
    "translation.svg": "Translation error, 0 to 180 degrees: share of pairs not above it",
    "epipolar.svg": "Median symmetric epipolar distance of a pair: share of pairs not above it",
    "motion.png": "Errors against the true rotation and the baseline, with medians",
}


def write_report(
    out: Path,
    pairs: DtuPairs,
    rows: Sequence[DtuScore],
    *,
    facts: Mapping[str, str],
    table: str,
    pictured: int = PICTURED,
) -> list[Path]:
    """Write all pictures of a finished run and its page into `out`; each appears whole.

    rotation, translation and epipolar as .png and .svg, motion.png, worst-METHOD.png for each
    method, and report.html, which needs none of the others.

    Args:
        out: the folder of the run, which holds the samples of matches.
        pairs: the pairs as the methods saw them.
        rows: records of all methods, those of one method in the order of the pairs.
        facts: what was run, by name: protocol, data, estimator, seed and so on.
        table: the summary of the methods, as text.
        pictured: how many pairs the page shows with images and matches, at most.

    Returns the files written. Raises InputError without rows or for a malformed sample, ImageError
    for an image that cannot be read.
    """
    methods, errors = by_method(rows), columns(rows)
    for left in out.glob(".report-*"):
        shutil.rmtree(left, ignore_errors=True)
        _log.warning("%s: removed, left by a run that has ended", left)
    with tempfile.TemporaryDirectory(dir=out, prefix=".report-") as name:
        folder = Path(name)
        for figure_name, figure in plot_histograms(errors, pairs.protocol).items():
            for kind in ("png", "svg"):
                save_figure(figure, folder / f"{figure_name}.{kind}", picture_format=kind)
        save_figure(plot_against_motion(errors), folder / "motion.png")
        for method, own in methods.items():
            worst = worst_pairs(own)
            shown = [pairs.by_key((row.scene, row.view1, row.view2)) for row in worst]
            samples = [read_sample(out, row.key) for row in worst]
            path = folder / f"worst-{method_file_name(method)}.png"
            save_figure(plot_worst(worst, shown, samples), path)
        chosen = pictured_pairs(methods, pictured)
        data = page_data(out, pairs, methods, chosen)
        page = _render(folder, data, len(chosen), facts, table)
        save_text(folder / PAGE, page)
        written = [out / file.name for file in sorted(folder.iterdir())]
        for path in written:
            os.replace(folder / path.name, path)
    return written


def pictured_pairs(methods: Mapping[str, Sequence[DtuScore]], count: int) -> frozenset[ViewKey]:
    """The pairs that the page has pictures of, at most `count`: the worst of each method, then from
    the start of the list."""
    worst = [worst_pairs(own) for own in methods.values()]
    by_rank = [pairs[rank] for rank in range(max(map(len, worst))) for pairs in worst]
    in_order = [*by_rank, *next(iter(methods.values()))]
    keys = [(row.scene, row.view1, row.view2) for row in in_order]
    return frozenset(list(dict.fromkeys(keys))[:count])


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
        data=data,
        pictured=pictured,
    )


def _plots(folder: Path) -> Iterable[Mapping[str, str]]:
    for name, caption in _CAPTIONS.items():
        kind = "image/svg+xml" if name.endswith(".svg") else "image/png"
        yield {"source": data_uri(kind, (folder / name).read_bytes()), "caption": caption}
