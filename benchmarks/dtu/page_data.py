"""What report.html knows, as data for JSON: pairs, images, and what each method made of each pair.

JSON has no infinity: null stands for it, and for a figure that a method does not have.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.benchmarks.dtu.entries import Entry
from dgc_pose.benchmarks.dtu.epipolar import true_fundamental
from dgc_pose.benchmarks.dtu.protocols import PairReader, ShownPair
from dgc_pose.benchmarks.dtu.records import DtuResult, DtuTiming
from dgc_pose.benchmarks.dtu.samples import MatchSample, read_sample
from dgc_pose.errors import InputError
from dgc_pose.image import Image

_THUMBNAIL = 240  # longest side, pixels
_JPEG_QUALITY = 70
_DIGITS = 10  # of an entry of F: a place in the largest image needs fewer

PairKey = tuple[int, int, int]  # scene, view1, view2


def page_data(
    out: Path,
    entries: Sequence[Entry],
    rows: Mapping[str, Sequence[DtuResult]],
    timings: Sequence[DtuTiming],
    reader: PairReader,
    pictured: Collection[PairKey],
) -> dict[str, Any]:
    """All that the page shows.

    Args:
        out: the folder of the run, where the samples of matches lie.
        entries: the pairs.
        rows: of each method, a row for each of the entries in their order.
        timings: of all rows, in any order.
        reader: reads the images as the methods saw them.
        pictured: the pairs to be shown with their images, matches and epipolar lines.

    Raises InputError where the rows are not those of the entries, and what `PairReader.read` and
    `read_sample` raise.
    """
    _require_same_pairs(entries, rows)
    images = _Thumbnails()
    pairs = []
    for entry, row in zip(entries, next(iter(rows.values())), strict=True):
        pair = _pair(row)
        if row.key[1:] in pictured:
            shown = reader.read(entry.scene, entry.view1, entry.view2, entry.pair)
            pair |= {
                "image1": images.number(shown.image1),
                "image2": images.number(shown.image2),
                "F": _fundamental(shown),
            }
        pairs.append(pair)
    seconds = {timing.key: timing.pose_seconds for timing in timings}
    results = []
    for own in rows.values():
        made = [_result(row, seconds[row.key]) for row in own]
        for record, row in zip(made, own, strict=True):
            if row.key[1:] in pictured:
                record["sample"] = flat_sample(read_sample(out, row.key))
        results.append(made)
    return {"methods": list(rows), "pairs": pairs, "images": images.records, "results": results}


def flat_sample(sample: MatchSample) -> list[int]:
    """x1, y1, x2, y2 in tenths of a pixel and 1 for an inlier or 0, match after match."""
    tenths = np.column_stack([sample.points1, sample.points2]) * 10
    columns = np.column_stack([np.rint(tenths), sample.inliers])
    return [int(value) for value in columns.ravel()]


def data_uri(kind: str, content: bytes) -> str:
    """A file of the MIME type `kind` within a page."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _require_same_pairs(
    entries: Sequence[Entry], rows: Mapping[str, Sequence[DtuResult]]
) -> None:
    keys = [(entry.scene, entry.view1, entry.view2) for entry in entries]
    for method, own in rows.items():
        if [row.key[1:] for row in own] != keys:
            raise InputError(f"the results of {method} are not those of the list's pairs")


class _Thumbnails:
    """The images of the page, each once."""

    def __init__(self) -> None:
        self.records: list[dict[str, Any]] = []
        self._numbers: dict[str, int] = {}

    def number(self, image: Image) -> int:
        """The image's place in `records`."""
        if image.name not in self._numbers:
            self._numbers[image.name] = len(self.records)
            width, height = image.size
            self.records.append({"width": width, "height": height, "source": _thumbnail(image)})
        return self._numbers[image.name]


def _thumbnail(image: Image) -> str:
    share = min(1.0, _THUMBNAIL / max(image.size))
    size = tuple(max(1, round(share * side)) for side in image.size)
    small = cv2.resize(image.pixels, size, interpolation=cv2.INTER_AREA)
    bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data_uri("image/jpeg", encoded.tobytes())


def _fundamental(shown: ShownPair) -> list[float]:
    """F row by row, of length 1."""
    F = true_fundamental(shown.truth)
    return [float(f"{value:.{_DIGITS}g}") for value in (F / np.linalg.norm(F)).ravel()]


def _pair(row: DtuResult) -> dict[str, Any]:
    return {
        "name": f"scan{row.scene} {row.view1}-{row.view2}",
        "rotation": row.true_rotation_deg,
        "baseline": row.true_baseline_mm,
        "overlap": row.overlap,
        "F": None,
    }


def _result(row: DtuResult, seconds: float) -> dict[str, Any]:
    return {
        "success": row.success,
        "status": row.status,
        "matches": row.num_matches,
        "inliers": row.num_inliers,
        "R": _finite(row.rotation_error_deg),
        "t": _finite(row.translation_error_deg),
        "folded": _finite(row.translation_folded_deg),
        "all": _finite(row.epipolar_all_px),
        "confident": _finite(row.epipolar_confident_px),
        "seconds": seconds,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
