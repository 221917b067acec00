"""The report of bench-hpatches and bench-synthetic: tables, JSON, and a CSV row a pair."""

import csv
from collections.abc import Mapping, Sequence
from typing import Any, TextIO

from dgc_pose.benchmarks.files import decimals, finite_data
from dgc_pose.benchmarks.map_scores import (
    ALL,
    FOUND_PX,
    PCK_THRESHOLDS,
    RIGHT_PX,
    WITHIN,
    MapSummary,
    PairScores,
    summarise_maps,
)
from dgc_pose.benchmarks.reliability import Reliability
from dgc_pose.files.tables import aligned
from dgc_pose.network.config import LEVEL_SIZES

Scores = Mapping[str, Sequence[PairScores]]  # by method, each over the same pairs

_LEVELS = LEVEL_SIZES[::-1]  # coarse to fine, as the scores have them
HEADING = (
    "errors in pixels of 240x240, over the pixels of known correspondence, no mask applied\n"
    "AEPE: mean of a pair, then over pairs; AEPE@15 to @240: of each level's map of a network\n"
    "PCK@1, 3, 5: percent of all pixels within so many, Euclidean\n"
    "Jaccard: the mask (matchability above one half) against what is visible, mean over pairs;\n"
    f"J found: against what is visible and found to within {FOUND_PX:g} px, "
    "which dgcm-lite's mask is trained for"
)


def groups_of(scores: Scores) -> list[str]:
    """The groups of the pairs, in their first order; pairs without a group have none."""
    first = next(iter(scores.values()))
    return list(dict.fromkeys(pair.group for pair in first if pair.group))


def summaries(scores: Scores, group: str = ALL) -> list[MapSummary]:
    """A summary a method, of one group or of all pairs."""
    return [summarise_maps(pairs, group) for pairs in scores.values()]


def figures_table(rows: Sequence[MapSummary], first: str = "method") -> str:
    """All figures of each summary, a line each."""
    header = [first, "pairs", "AEPE"]
    header += [f"AEPE@{cells}" for cells in _LEVELS]
    header += [f"PCK@{limit:g}" for limit in WITHIN]
    cells = (
        (
            *(row.method, str(row.pairs), decimals(row.aepe, 2)),
            *(decimals(value, 2) for value in row.level_aepe),
            *(decimals(100 * value, 1) for value in row.within),
            *(decimals(row.jaccard, 3), decimals(row.jaccard_found, 3)),
        )
        for row in rows
    )
    return aligned([[*header, "Jaccard", "J found"], *cells])


def groups_table(
    scores: Scores, figure: str, digits: int, published: Mapping[str, Sequence[float]]
) -> str:
    """A figure, "aepe" or "jaccard", of each method by group, and published rows below."""
    groups = groups_of(scores)
    lines = [["method", *groups, ALL]]
    for method, pairs in scores.items():
        grouped = summarise_maps([pair for pair in pairs if pair.group])
        parts = [*(summarise_maps(pairs, group) for group in groups), grouped]
        lines.append([method, *(decimals(getattr(part, figure), digits) for part in parts)])
    for name, values in published.items():
        lines.append([name, *(decimals(value, digits) for value in values), "-"])
    return aligned(lines)


def pairs_table(scores: Scores) -> str:
    """The AEPE of every pair without a group, a line each, a column a method; and the share of
    its pixels of known correspondence."""
    lines = [["pair", "valid", *scores]]
    for results in zip(*scores.values(), strict=True):
        pair = results[0]
        if not pair.group:
            valid = f"{100 * pair.valid / _LEVELS[-1] ** 2:.0f} %"
            lines.append([pair.name, valid, *(decimals(result.aepe, 2) for result in results)])
    return aligned(lines)


def reliability_lines(scores: Scores) -> list[str]:
    """For each method that has a mask, the share of right matches by matchability, on one line."""
    lines = []
    for summary in summaries(scores):
        if summary.reliability is None:
            continue
        shares = " ".join(decimals(100 * v, 0) for v in summary.reliability.share_correct)
        lines.append(
            f"{summary.method}: percent within {RIGHT_PX:g} px by tenths of matchability: "
            f"{shares}; expected calibration error "
            f"{decimals(100 * summary.reliability.calibration_error, 1)} %"
        )
    return lines


def report_data(scores: Scores) -> dict[str, Any]:
    """All figures for JSON; null for a figure that does not exist."""
    methods = []
    for method, pairs in scores.items():
        total = summarise_maps(pairs)
        methods.append(
            {
                "method": method,
                "all": _summary_data(total),
                "groups": [_summary_data(summarise_maps(pairs, g)) for g in groups_of(scores)],
                "reliability": total.reliability and _reliability_data(total.reliability),
                "pairs": [_pair_data(pair) for pair in pairs],
            }
        )
    return {"pck_thresholds_px": PCK_THRESHOLDS.tolist(), "methods": finite_data(methods)}


def write_pairs(stream: TextIO, scores: Scores) -> None:
    """A CSV row for each method and pair."""
    pairs = [pair for of_method in scores.values() for pair in of_method]
    rows = [{"method": pair.method, **finite_data(_pair_data(pair))} for pair in pairs]
    writer = csv.DictWriter(stream, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)


def _summary_data(summary: MapSummary) -> dict[str, Any]:
    shares = zip(WITHIN, summary.within, strict=True)
    return {
        "group": summary.group,
        "pairs": summary.pairs,
        **_errors(summary),
        **{f"pck{limit:g}": share for limit, share in shares},
        **_overlaps(summary),
        "pck": summary.pck.tolist(),
    }


def _pair_data(scores: PairScores) -> dict[str, Any]:
    names = {"group": scores.group, "pair": scores.name, "valid_pixels": scores.valid}
    return {**names, **_errors(scores), **_overlaps(scores)}


def _errors(figures: PairScores | MapSummary) -> dict[str, float]:
    levels = zip(_LEVELS, figures.level_aepe, strict=True)
    return {"aepe": figures.aepe, **{f"aepe{cells}": aepe for cells, aepe in levels}}


def _overlaps(figures: PairScores | MapSummary) -> dict[str, float]:
    return {"jaccard": figures.jaccard, "jaccard_found": figures.jaccard_found}


def _reliability_data(reliability: Reliability) -> dict[str, Any]:
    return {
        "right_within_px": RIGHT_PX,
        "edges": reliability.edges.tolist(),
        "counts": reliability.counts.tolist(),
        "share_correct": reliability.share_correct.tolist(),
        "mean_confidence": reliability.mean_confidence.tolist(),
        "expected_calibration_error": reliability.calibration_error,
    }
