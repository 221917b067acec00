"""The data of report.html, for JSON: pairs, images, and what each method made of each pair.

JSON has no infinity: null stands for it, and for a figure that a method does not have.
"""

from __future__ import annotations

import base64
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.benchmarks.dtu.dtu_pairs import DtuPairs, ViewKey
from dgc_pose.benchmarks.posed_pairs import Truth
from dgc_pose.benchmarks.samples import MatchSample, read_sample
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.files.json_files import finite_or_none
from dgc_pose.images.image import Image
from dgc_pose.metrics.epipolar import true_fundamental

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


def page_data(
    out: Path,
    pairs: DtuPairs,
    rows: Mapping[str, Sequence[DtuScore]],
    pictured: Collection[ViewKey],
) -> dict[str, Any]:
    """All that the page shows.

    Args:
        out: the folder of the run, which holds the samples of matches.
        pairs: the pairs as the methods saw them.
        rows: of each method, a record for each of the pairs in their order.
        pictured: the pairs to be shown with their images, matches and epipolar lines.

    Raises what `read_sample` and reading the images raise.
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


def data_uri(kind: str, content: bytes) -> str:
    """A file of the MIME type `kind` within a page."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _result(out: Path, row: DtuScore, pictured: Collection[ViewKey]) -> dict[str, Any]:
    values = {key: getattr(row, name) for key, name in _RESULT.items()}
    result = {k: finite_or_none(v) if isinstance(v, float) else v for k, v in values.items()}
    if row.key[1:] in pictured:
        result["sample"] = _flat(read_sample(out, row.key))
    return result


def _flat(sample: MatchSample) -> list[int]:
    """x1, y1, x2, y2 in tenths of a pixel and 1 for an inlier or 0, match after match."""
    tenths = np.column_stack([sample.points1, sample.points2]) * 10
    columns = np.column_stack([np.rint(tenths), sample.inliers])
    return [int(value) for value in columns.ravel()]


def _thumbnail(image: Image) -> dict[str, Any]:
    share = min(1.0, _THUMBNAIL / max(image.size))
    size = tuple(max(1, round(share * side)) for side in image.size)
    small = cv2.resize(image.pixels, size, interpolation=cv2.INTER_AREA)
    bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    width, height = image.size
    source = data_uri("image/jpeg", encoded.tobytes())
    return {"width": width, "height": height, "source": source}


def _fundamental(truth: Truth) -> list[float]:
    """F row by row, of length 1."""
    assert truth.R is not None and truth.t is not None
    F = true_fundamental(truth.camera1, truth.camera2, truth.R, truth.t)
    return [float(f"{value:.{_DIGITS}g}") for value in (F / np.linalg.norm(F)).ravel()]
