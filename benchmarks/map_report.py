"""The report of bench-maps: the table, and all figures as data."""

from collections.abc import Mapping, Sequence
from typing import Any

from dgc_pose.benchmarks.files import decimals, finite_data
from dgc_pose.benchmarks.map_scores import (
    FOUND_PX,
    PCK_THRESHOLDS,
    RIGHT_PX,
    WITHIN,
    MapScore,
    pooled,
)
from dgc_pose.files.tables import aligned
from dgc_pose.network.config import LEVEL_SIZES

Scores = Mapping[str, Sequence[MapScore]]  # by method, each over the same pairs
HEADING = (
    "errors in pixels of 240x240, over the pixels of known correspondence, no mask applied\n"
    "AEPE: mean of a pair, then over pairs; AEPE@15 to @240: of each level's map of a network\n"
    "PCK@1, 3, 5: percent of all pixels within so many, Euclidean\n"
    "Jaccard: the mask (matchability above one half) against what is visible, mean over pairs;\n"
    f"J found: against what is visible and found to within {FOUND_PX:g} px, "
    "which dgcm-lite's mask is trained for"
)


def groups_of(scores: Scores) -> list[str]:
    """The groups of the pairs, in their first order."""
    return list(dict.fromkeys(pair.group for pair in next(iter(scores.values()))))


def maps_table(scores: Scores) -> str:
    """A line a group and method, and over all pairs."""
    columns = {"pairs": ("pairs", 1, 0), "AEPE": ("aepe", 1, 2)}
    columns |= {f"AEPE@{cells}": (f"aepe{cells}", 1, 2) for cells in LEVEL_SIZES[::-1]}
    columns |= {f"PCK@{limit:g}": (f"pck{limit:g}", 100, 1) for limit in WITHIN}
    columns |= {"Jaccard": ("jaccard", 1, 3), "J found": ("jaccard_found", 1, 3)}
    lines = [["group", "method", *columns]]
    for group in [*groups_of(scores), "all"]:
        for method, pairs in scores.items():
            data = pooled(pairs, group).data
            cells = (decimals(factor * data[name], n) for name, factor, n in columns.values())
            lines.append([group, method, *cells])
    return aligned(lines)


def reliability_lines(scores: Scores) -> list[str]:
    """For each method that has a mask, the share of right matches by matchability, on one line."""
    lines = []
    for method, pairs in scores.items():
        if (reliability := pooled(pairs).reliability) is not None:
            shares = " ".join(decimals(100 * v, 0) for v in reliability.share_correct)
            lines.append(
                f"{method}: percent within {RIGHT_PX:g} px by tenths of matchability: {shares}; "
                "expected calibration error "
                f"{decimals(100 * reliability.calibration_error, 1)} %"
            )
    return lines


def report_data(scores: Scores) -> dict[str, Any]:
    """All figures, with null for one that is NaN: of each group and of all pairs by each method."""
    methods = []
    for method, pairs in scores.items():
        total = pooled(pairs)
        reliability = None
        if total.reliability is not None:
            reliability = {
                "right_within_px": RIGHT_PX,
                "edges": total.reliability.edges.tolist(),
                "counts": total.reliability.counts.tolist(),
                "share_correct": total.reliability.share_correct.tolist(),
                "mean_confidence": total.reliability.mean_confidence.tolist(),
                "expected_calibration_error": total.reliability.calibration_error,
            }
        methods.append(
            {
                "method": method,
                "all": {**total.data, "pck": total.pck.tolist()},
                "groups": [pooled(pairs, group).data for group in groups_of(scores)],
                "reliability": reliability,
            }
        )
    return {"pck_thresholds_px": PCK_THRESHOLDS.tolist(), "methods": finite_data(methods)}
