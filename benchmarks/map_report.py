"""The report of bench-hpatches and bench-synthetic: tables, JSON, and a CSV row a pair."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from typing import Any, TextIO

import numpy as np

from dgc_pose.benchmarks.table import aligned
from dgc_pose.evaluation.map_scores import (
    FOUND_PX,
    PCK_THRESHOLDS,
    RIGHT_PX,
    WITHIN,
    MapSummary,
    PairScores,
    summarise_maps,
)
from dgc_pose.files.json_files import finite_or_none
from dgc_pose.metrics import Reliability
from dgc_pose.network.config import LEVEL_SIZES

Scores = Mapping[str, Sequence[PairScores]]  # by method, each over the same pairs
ALL = "all"

_LEVELS = LEVEL_SIZES[::-1]  # coarse to fine, as the scores have them
HEADING = (
    "errors in pixels of 240x240, over the pixels of known correspondence, no mask applied\n"
    "AEPE: mean of a pair, then over pairs; AEPE@15 to @240: of each pyramid level's map\n"
    "PCK@1, 3, 5: percent of all pixels within so many, Euclidean\n"
    "Jaccard: the mask (matchability above one half) against what is visible, mean over pairs;\n"
    f"J found: against what is visible and found to within {FOUND_PX:g} px, "
    "which dgcm-lite0's mask is trained for"
)


def groups_of(scores: Scores) -> list[str]:
    """The groups of the pairs, in their first order; pairs without a group have none."""
    first = next(iter(scores.values()))
    return list(dict.fromkeys(own.group for own in first if own.group))


def summaries(scores: Scores, group: str | None = None) -> list[MapSummary]:
    """A summary a method, of one group or of all pairs."""
    chosen = {
        method: [one for one in own if group is None or one.group == group]
        for method, own in scores.items()
    }
    return [summarise_maps(own, ALL if group is None else group) for own in chosen.values()]


def figures_table(rows: Sequence[MapSummary], first: str = "method") -> str:
    """All figures of each summary, a line each."""
    header = [first, "pairs", "AEPE"]
    header += [f"AEPE@{cells}" for cells in _LEVELS]
    header += [f"PCK@{limit:g}" for limit in WITHIN]
    return aligned([[*header, "Jaccard", "J found"], *(_cells(row) for row in rows)])


def groups_table(
    scores: Scores, figure: str, digits: int, published: Mapping[str, Sequence[float]]
) -> str:
    """One figure, "aepe" or "jaccard", of each method by group, and published rows below."""
    groups = groups_of(scores)
    lines = [["method", *groups, ALL]]
    for method, own in scores.items():
        parts = [[one for one in own if one.group == group] for group in groups]
        parts.append([one for one in own if one.group])
        cells = [getattr(summarise_maps(part), figure) for part in parts]
        lines.append([method, *(_number(value, digits) for value in cells)])
    for name, values in published.items():
        lines.append([name, *(_number(value, digits) for value in values), "-"])
    return aligned(lines)


def pairs_table(scores: Scores) -> str:
    """The AEPE of every pair without a group, a line each, a column a method; and the share of
    its pixels of known correspondence."""
    lines = [["pair", "valid", *scores]]
    for own in zip(*scores.values(), strict=True):
        if own[0].group:
            continue
        valid = f"{100 * own[0].valid / _LEVELS[-1] ** 2:.0f} %"
        lines.append([own[0].name, valid, *(_number(one.aepe, 2) for one in own)])
    return aligned(lines)


def reliability_line(method: str, reliability: Reliability) -> str:
    """The share of right matches by matchability, on one line."""
    shares = " ".join(_number(100 * value, 0) for value in reliability.share_correct)
    return (
        f"{method}: percent within {RIGHT_PX:g} px by tenths of matchability: {shares}; "
        f"expected calibration error {_number(100 * reliability.calibration_error, 1)} %"
    )


def reliability_lines(scores: Scores) -> list[str]:
    """A line for each method that has a mask."""
    return [
        reliability_line(summary.method, summary.reliability)
        for summary in summaries(scores)
        if summary.reliability is not None
    ]


def report_data(scores: Scores) -> dict[str, Any]:
    """All figures for JSON; null for a figure that does not exist."""
    methods = []
    for method, own in scores.items():
        groups = [
            summarise_maps([one for one in own if one.group == group])
            for group in groups_of(scores)
        ]
        total = summarise_maps(own, ALL)
        reliability = total.reliability
        methods.append(
            {
                "method": method,
                "all": _summary_data(total),
                "groups": [_summary_data(group) for group in groups],
                "reliability": None if reliability is None else _reliability_data(reliability),
                "pairs": [_pair_data(one) for one in own],
            }
        )
    return {"pck_thresholds_px": PCK_THRESHOLDS.tolist(), "methods": methods}


def write_pairs(stream: TextIO, scores: Scores) -> None:
    """A CSV row for each method and pair."""
    rows = [{"method": m, **_pair_data(one)} for m, own in scores.items() for one in own]
    writer = csv.DictWriter(stream, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)


def _cells(summary: MapSummary) -> list[str]:
    return [
        summary.method,
        str(summary.pairs),
        _number(summary.aepe, 2),
        *(_number(value, 2) for value in summary.level_aepe),
        *(_number(100 * value, 1) for value in summary.within),
        _number(summary.jaccard, 3),
        _number(summary.jaccard_found, 3),
    ]


def _summary_data(summary: MapSummary) -> dict[str, Any]:
    return {
        "group": summary.group,
        "pairs": summary.pairs,
        **_figures(summary.aepe, summary.level_aepe),
        **{f"pck{w:g}": finite_or_none(v) for w, v in zip(WITHIN, summary.within, strict=True)},
        "jaccard": finite_or_none(summary.jaccard),
        "jaccard_found": finite_or_none(summary.jaccard_found),
        "pck": _finite_list(summary.pck),
    }


def _pair_data(scores: PairScores) -> dict[str, Any]:
    return {
        "group": scores.group,
        "pair": scores.name,
        "valid_pixels": scores.valid,
        **_figures(scores.aepe, scores.level_aepe),
        "jaccard": finite_or_none(scores.jaccard),
        "jaccard_found": finite_or_none(scores.jaccard_found),
    }


def _figures(aepe: float, levels: Sequence[float]) -> dict[str, float | None]:
    named = {f"aepe{cells}": finite_or_none(v) for cells, v in zip(_LEVELS, levels, strict=True)}
    return {"aepe": finite_or_none(aepe), **named}


def _reliability_data(reliability: Reliability) -> dict[str, Any]:
    return {
        "right_within_px": RIGHT_PX,
        "edges": reliability.edges.tolist(),
        "counts": reliability.counts.tolist(),
        "share_correct": _finite_list(reliability.share_correct),
        "mean_confidence": _finite_list(reliability.mean_confidence),
        "expected_calibration_error": finite_or_none(reliability.calibration_error),
    }


def _finite_list(values: np.ndarray) -> list[float | None]:
    return [finite_or_none(value) for value in values]


def _number(value: float, digits: int) -> str:
    return "-" if finite_or_none(value) is None else f"{value:.{digits}f}"
