"""The report of a finished DTU run: its figures, and report.html with the pairs and their matches.

Its data are JSON, which has no infinity: null stands for it, and for a figure that a method lacks.
"""

import base64
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import jinja2
import numpy as np

from dgc_pose.benchmarks.dtu.dtu_pairs import DtuPairs, ViewKey
from dgc_pose.benchmarks.posed_pairs import Truth
from dgc_pose.benchmarks.samples import read_sample
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.benchmarks.summary import by_method, columns
from dgc_pose.files.json_files import finite_data
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.images.image import Image
from dgc_pose.metrics.epipolar import true_fundamental
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
_MIME = {"svg": "image/svg+xml", "png": "image/png", "jpg": "image/jpeg"}
_THUMBNAIL = 240  # longest side, pixels
_JPEG_QUALITY = 70
_DIGITS = 10  # of an entry of F: a point in the largest image needs fewer
_RESULT = {  # key in the page's data: field of the record
    "success": "success",
    "status": "status",
    "matches": "num_matches",
    "inliers": "num_inliers",
    "R": "rotation_error_deg",
    "t": "translation_error_deg",
    "folded": "translation_folded_deg",
    "all": "epipolar_all_px",
    "confident": "epipolar_confident_px",
    "seconds": "estimate_seconds",
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

    rows: records of all methods, those of a method in the order of the pairs. facts: what was run,
    by name. table: the summary, as text. pictured: how many pairs the page shows with images and
    matches, at most. Returns the files written. Raises InputError without rows or for a malformed
    sample, ImageError for an image that cannot be read.
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
                {
                    "source": _data_uri(name[-3:], files[name].read_bytes()),
                    "caption": caption,
                }
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


def page_data(
    out: Path,
    pairs: DtuPairs,
    rows: Mapping[str, Sequence[DtuScore]],
    pictured: Collection[ViewKey],
) -> dict[str, Any]:
    """All that the page shows: the rows of each method, in the order of the pairs, and images,
    matches and F of those pairs that are `pictured`. Raises what reading samples and images does.
    """
    images: dict[str, dict[str, Any]] = {}  # by name, each once
    entries = []
    for number, row in enumerate(next(iter(rows.values()))):
        entry = {
            "name": f"scan{row.scene} {row.view1}-{row.view2}",
            "rotation": row.true_rotation_deg,
            "baseline": row.true_baseline_mm,
            "overlap": row.overlap,
            "F": None,
        }
        if row.key[1:] in pictured:
            posed = pairs.pair(number)
            for image in (posed.image1, posed.image2):
                if image.name not in images:
                    images[image.name] = _thumbnail(image)
            names = list(images)
            entry |= {
                "image1": names.index(posed.image1.name),
                "image2": names.index(posed.image2.name),
                "F": _fundamental(posed.truth),
            }
        entries.append(entry)
    results = [[_result(out, row, pictured) for row in of_method] for of_method in rows.values()]
    images_data = list(images.values())
    return {"methods": list(rows), "pairs": entries, "images": images_data, "results": results}


def _rank(row: DtuScore) -> tuple[object, ...]:
    """The larger of rotation and folded translation error first, infinite without a pose."""
    return -max(row.rotation_error_deg, row.translation_folded_deg), row.key


def _data_uri(kind: str, content: bytes) -> str:
    """A file within a page; kind: its name's ending."""
    return f"data:{_MIME[kind]};base64,{base64.b64encode(content).decode('ascii')}"


def _result(out: Path, row: DtuScore, pictured: Collection[ViewKey]) -> dict[str, Any]:
    result: dict[str, Any] = finite_data({k: getattr(row, name) for k, name in _RESULT.items()})
    if row.key[1:] in pictured:
        # x1, y1, x2, y2 in tenths of a pixel and 1 for an inlier or 0, match after match
        sample = read_sample(out, row.key)
        tenths = np.rint(np.column_stack([sample.points1, sample.points2]) * 10)
        flat = np.column_stack([tenths, sample.inliers]).ravel()
        result["sample"] = flat.astype(int).tolist()
    return result


def _thumbnail(image: Image) -> dict[str, Any]:
    share = min(1.0, _THUMBNAIL / max(image.size))
    size = tuple(max(1, round(share * side)) for side in image.size)
    small = cv2.resize(image.pixels, size, interpolation=cv2.INTER_AREA)
    bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    width, height = image.size
    source = _data_uri("jpg", encoded.tobytes())
    return {"width": width, "height": height, "source": source}


def _fundamental(truth: Truth) -> list[float]:
    """F row by row, of length 1."""
    assert truth.R is not None and truth.t is not None
    F = true_fundamental(truth.camera1, truth.camera2, truth.R, truth.t)
    return [float(f"{value:.{_DIGITS}g}") for value in (F / np.linalg.norm(F)).ravel()]
