"""What bench-pairs puts on paper: CSV rows, the summary as data and as a table."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any, TextIO

from dgc_pose.benchmarks.pairs import MethodSummary, PairResult
from dgc_pose.benchmarks.table import aligned
from dgc_pose.estimation import EstimationOptions

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

COLUMNS = (
    "method",
    "pairs",
    "failures",
    "R med",
    "t med",
    "t folded",
    "AUC@5",
    "AUC@10",
    "AUC@20",
    "s/pair",
)


class ResultsTable:
    """Writes results.csv: the header at once, then each row as it comes, so that a run that is cut
    short leaves all that it had finished. A row is a dataclass `kind`, a column a field."""

    def __init__(
        self, stream: TextIO, kind: type[DataclassInstance] = PairResult, *, header: bool = True
    ) -> None:
        self._stream = stream
        self._writer = csv.DictWriter(stream, [field.name for field in fields(kind)])
        if header:
            self._writer.writeheader()
            stream.flush()

    def add(self, result: DataclassInstance) -> None:
        self._writer.writerow(asdict(result))
        self._stream.flush()


def summary_data(summaries: Sequence[MethodSummary]) -> dict[str, Any]:
    """The summary for JSON, with null where a figure is infinite (JSON has no infinity)."""
    return {"methods": [_finite(asdict(summary)) for summary in summaries]}


def heading(options: EstimationOptions) -> str:
    """What the table's columns mean, and the estimator that all methods went through."""
    threshold = f"{options.threshold_factor:g} x the matcher's error"
    if options.threshold_px is not None:
        threshold = f"{options.threshold_px:g} px"
    return (
        f"estimator {options.estimator}, {options.runs} runs of {options.iterations} iterations, "
        f"threshold {threshold}, seed {options.seed}\n"
        "medians in degrees over all pairs, a failure counted as infinite; t: 0 to 180, "
        "t folded: min(e, 180 - e)\n"
        "AUC in percent, of max(R, t folded); s/pair: matching and estimating"
    )


def summary_table(
    summaries: Sequence[MethodSummary], more: Mapping[str, Sequence[str]] | None = None
) -> str:
    """The summary as a table for people; angles in degrees, AUC in percent.

    more: further columns, by heading, a cell a summary.
    """
    others = more or {}
    rows: list[tuple[str, ...]] = [(*COLUMNS, *others)]
    for summary, *cells in zip(summaries, *others.values(), strict=True):
        rows.append((*_cells(summary), *cells))
    return aligned(rows)


def _cells(summary: MethodSummary) -> tuple[str, ...]:
    share = 100 * summary.failures / summary.pairs
    return (
        summary.method,
        str(summary.pairs),
        f"{summary.failures} ({share:.1f} %)",
        f"{summary.median_rotation_deg:.2f}",
        f"{summary.median_translation_deg:.2f}",
        f"{summary.median_translation_folded_deg:.2f}",
        f"{summary.auc5:.1f}",
        f"{summary.auc10:.1f}",
        f"{summary.auc20:.1f}",
        f"{summary.seconds_per_pair:.2f}",
    )


def _finite(record: dict[str, Any]) -> dict[str, Any]:
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in record.items()
    }
