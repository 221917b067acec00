"""The figures of each method over all pairs of a DTU run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from dgc_pose.benchmarks.dtu.records import DtuResult, DtuTiming
from dgc_pose.benchmarks.pairs import MethodSummary, PairResult, summarise
from dgc_pose.benchmarks.report import summary_table


@dataclass(frozen=True)
class DtuSummary(MethodSummary):
    """One method over all pairs; the fields are the keys of summary.json."""

    # Medians over the pairs of the pairs' median D_e, pixels of the protocol's images
    median_epipolar_px: float  # over all pixels; NaN for a method without a map
    median_epipolar_confident_px: float  # over the matches that the pose is estimated from
    matches_per_pair: float  # mean
    match_seconds_per_pair: float  # mean
    pose_seconds_per_pair: float  # mean, of the processor; seconds_per_pair is the sum of both


def summarise_methods(
    results: Sequence[DtuResult], timings: Sequence[DtuTiming]
) -> list[DtuSummary]:
    """The figures of every method, in the order in which they come. results, timings: as in their
    files, row for row."""
    by_method: dict[str, list[tuple[DtuResult, DtuTiming]]] = {}
    for result, timing in zip(results, timings, strict=True):
        by_method.setdefault(result.method, []).append((result, timing))
    return [_summarise(rows) for rows in by_method.values()]


def dtu_table(summaries: Sequence[DtuSummary]) -> str:
    """The summary as bench-pairs prints it, with D_e, its matches and the pose stage's time."""
    return summary_table(
        summaries,
        {
            "D_e all": [_number(s.median_epipolar_px, 2) for s in summaries],
            "D_e conf": [_number(s.median_epipolar_confident_px, 2) for s in summaries],
            "matches": [_number(s.matches_per_pair, 0) for s in summaries],
            "pose s": [_number(s.pose_seconds_per_pair, 3) for s in summaries],
        },
    )


def _summarise(rows: Sequence[tuple[DtuResult, DtuTiming]]) -> DtuSummary:
    common = summarise([_pair_result(*row) for row in rows])
    return DtuSummary(
        **{field.name: getattr(common, field.name) for field in fields(common)},
        median_epipolar_px=_median([result.epipolar_all_px for result, _ in rows]),
        median_epipolar_confident_px=_median([r.epipolar_confident_px for r, _ in rows]),
        matches_per_pair=float(np.mean([result.num_matches for result, _ in rows])),
        match_seconds_per_pair=float(np.mean([timing.match_seconds for _, timing in rows])),
        pose_seconds_per_pair=float(np.mean([timing.pose_seconds for _, timing in rows])),
    )


def _pair_result(result: DtuResult, timing: DtuTiming) -> PairResult:
    shared = {field.name for field in fields(PairResult)} & {f.name for f in fields(DtuResult)}
    return PairResult(
        **{name: getattr(result, name) for name in shared},
        match_seconds=timing.match_seconds,
        estimate_seconds=timing.pose_seconds,
    )


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))


def _number(value: float, decimals: int) -> str:
    return "-" if np.isnan(value) else f"{value:.{decimals}f}"
