"""The report of a finished DTU run: its figures, and report.html with its pairs."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path

import jinja2

from dgc_pose.benchmarks.dtu.histograms import plot_histograms
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.benchmarks.summary import by_method, columns
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.viz.figure import save_figure

PAGE = "report.html"
HEADINGS = {  # of the table of pairs
    "pair": "scan{0.scene} {0.view1}-{0.view2}",
    "rotation°": "{0.true_rotation_deg:.1f}",
    "mm": "{0.true_baseline_mm:.0f}",
    "overlap": "{0.overlap:.2f}",
    "R err°": "{0.rotation_error_deg:.2f}",
    "t err°": "{0.translation_error_deg:.2f}",
    "t folded°": "{0.translation_folded_deg:.2f}",
    "D_e all": "{0.epipolar_all_px:.2f}",
    "D_e conf": "{0.epipolar_confident_px:.2f}",
    "matches": "{0.num_matches}",
    "inliers": "{0.num_inliers}",
    "pose s": "{0.estimate_seconds:.3f}",
    "status": "{0.status}",
}
_TEMPLATES = Path(__file__).parent / "templates"
_CAPTIONS = {
    "rotation.svg": "Rotation error: share of pairs not above it",
    "translation.svg": "Translation error, 0 to 180 degrees: share of pairs not above it",
    "epipolar.svg": "Median symmetric epipolar distance of a pair: share of pairs not above it",
}


def write_report(
    out: Path, rows: Sequence[DtuScore], *, facts: Mapping[str, str], table: str
) -> None:
    """Write the figures of a finished run and its page into `out`; each appears whole.

    rows: records of all methods. facts: what was run, by name. table: the summary, as text. Raises
    InputError without rows.
    """
    histograms = plot_histograms(columns(rows), rows[0].protocol)
    figures = {f"{name}.{kind}": histograms[name] for name in histograms for kind in ("png", "svg")}
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
            facts=facts,
            table=table,
            headings=HEADINGS,
            plots=[
                {"svg": base64.b64encode(files[name].read_bytes()).decode(), "caption": caption}
                for name, caption in _CAPTIONS.items()
            ],
            methods=by_method(rows),
        )
        save_text(files[PAGE], page)
