"""The report of a finished DTU run: its figures, the worst pairs, and report.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import jinja2

from dgc_pose.benchmarks.dtu.dtu_pairs import DtuPairs, ViewKey
from dgc_pose.benchmarks.dtu.page_data import data_uri, page_data
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.benchmarks.summary import by_method, columns
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.viz.figure import save_figure
from dgc_pose.viz.motion import plot_against_motion, plot_histograms

PAGE = "report.html"
WORST = 10  # pairs of each method that have pictures first
PICTURED = 300  # pairs with pictures in the page: more make a file that opens slowly
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
    """Write the figures of a finished run and its page into `out`; each appears whole.

    rotation, translation and epipolar as .png and .svg, motion.png, and report.html, which needs
    none of the others.

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
    histograms = plot_histograms(errors, pairs.protocol)
    figures = {f"{name}.{kind}": histograms[name] for name in histograms for kind in ("png", "svg")}
    figures["motion.png"] = plot_against_motion(errors)
    chosen = pictured_pairs(methods, pictured)
    data = page_data(out, pairs, methods, chosen)
    paths = {name: out / name for name in (*figures, PAGE)}
    with staged(*map(str, paths.values())) as stage:
        files = {name: stage(str(path)) for name, path in paths.items()}
        for name, figure in figures.items():
            save_figure(figure, files[name])
        environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(_TEMPLATES),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
        )
        page = environment.get_template(PAGE).render(
            title="Relative camera pose on DTU",
            facts=facts,
            table=table,
            plots=[
                {"source": _picture_uri(name, files[name]), "caption": caption}
                for name, caption in _CAPTIONS.items()
            ],
            data=data,
            pictured=len(chosen),
        )
        save_text(files[PAGE], page)
    return [*paths.values()]


def pictured_pairs(methods: Mapping[str, Sequence[DtuScore]], count: int) -> frozenset[ViewKey]:
    """The pairs that the page has pictures of, at most `count`: the worst of each method, then from
    the start of the list."""
    worst = [sorted(rows, key=_rank)[:WORST] for rows in methods.values()]
    by_rank = [rows[rank] for rank in range(max(map(len, worst))) for rows in worst]
    in_order = [*by_rank, *next(iter(methods.values()))]
    keys = [(row.scene, row.view1, row.view2) for row in in_order]
    return frozenset(list(dict.fromkeys(keys))[:count])


def _rank(row: DtuScore) -> tuple[object, ...]:
    """The larger of rotation and folded translation error first, infinite without a pose."""
    return -max(row.rotation_error_deg, row.translation_folded_deg), row.key


def _picture_uri(name: str, file: Path) -> str:
    kind = "image/svg+xml" if name.endswith(".svg") else "image/png"
    return data_uri(kind, file.read_bytes())
