"""The report of a finished DTU run: its figures, and report.html with its pairs."""

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import jinja2
import numpy as np

from dgc_pose.benchmarks.dtu.dtu_pairs import DtuPairs
from dgc_pose.benchmarks.dtu.histograms import plot_histograms
from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.benchmarks.scores import MATCHES, DtuScore
from dgc_pose.benchmarks.summary import by_method, columns
from dgc_pose.files.inputs import read_as
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.images.image import picture_url
from dgc_pose.viz.figure import save_figure

PAGE = "report.html"
WORST = 10  # pairs of each method that have a picture
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
_CAPTION = "{0.status}: R off {0.rotation_error_deg:.2f}°, t off {0.translation_error_deg:.2f}°"
_HEIGHT = 240  # pixels of a picture
_GREEN, _RED = (46, 158, 91), (210, 67, 47)
_JPEG_QUALITY = 80


def write_report(
    out: Path,
    pairs: DtuPairs,
    rows: Sequence[DtuScore],
    *,
    facts: Mapping[str, str],
    table: str,
) -> None:
    """Write the figures of a finished run and its page into `out`; each appears whole.

    rows: records of all methods, those of a method in the order of the pairs. facts: what was run,
    by name. table: the summary, as text. Raises InputError without rows or for a malformed sample,
    ImageError for an image that cannot be read.
    """
    methods, errors = by_method(rows), columns(rows)
    histograms = plot_histograms(errors, pairs.protocol)
    figures = {f"{name}.{kind}": histograms[name] for name in histograms for kind in ("png", "svg")}
    shown = [
        {"name": name, "rows": of_method, "worst": _worst(out, pairs, of_method)}
        for name, of_method in methods.items()
    ]
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
                {"source": _svg_url(files[name].read_bytes()), "caption": caption}
                for name, caption in _CAPTIONS.items()
            ],
            methods=shown,
        )
        save_text(files[PAGE], page)


def _worst(out: Path, pairs: DtuPairs, rows: Sequence[DtuScore]) -> list[dict[str, str]]:
    """Pictures of the pairs of a method with the largest errors, infinite without a pose."""
    numbered = sorted(
        enumerate(rows),
        key=lambda item: -max(item[1].rotation_error_deg, item[1].translation_folded_deg),
    )
    pictures = []
    for number, row in numbered[:WORST]:
        with read_as("a table with samples of matches", out / MATCHES):
            sample = np.array(json.loads(row.sample), np.float64).reshape(-1, 5)
        picture = draw_pair(pairs.pair(number), sample)
        source = picture_url(picture, "jpeg", cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY)
        caption = f"{HEADINGS['pair']}, {_CAPTION}".format(row)
        pictures.append({"source": source, "caption": caption})
    return pictures


def draw_pair(pair: PosedPair, sample: np.ndarray) -> np.ndarray:
    """Both images (H, W, 3) side by side at one height, and a line for each match.

    sample: (N, 5), of each match x1, y1, x2, y2, pixels, and whether it is an inlier.
    """
    halves, ends = [], []
    left = 0
    for image, points in ((pair.image1, sample[:, :2]), (pair.image2, sample[:, 2:4])):
        scale = _HEIGHT / image.size[1]
        size = (max(1, round(scale * image.size[0])), _HEIGHT)
        halves.append(cv2.resize(image.pixels, size, interpolation=cv2.INTER_AREA))
        ends.append(np.rint((points + 0.5) * scale - 0.5).astype(int) + (left, 0))
        left += size[0]
    picture = np.hstack(halves)
    for end1, end2, inlier in zip(*ends, sample[:, 4], strict=True):
        colour = _GREEN if inlier else _RED
        cv2.line(picture, end1.tolist(), end2.tolist(), colour, 1, cv2.LINE_AA)
    return picture


def _svg_url(content: bytes) -> str:
    """A picture within a page."""
    return f"data:image/svg+xml;base64,{base64.b64encode(content).decode('ascii')}"
