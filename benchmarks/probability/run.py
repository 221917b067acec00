"""Fit, calibration and report in one go, from stored matches."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from dgc_pose.benchmarks.probability.collection import read_collection, read_engine
from dgc_pose.benchmarks.probability.fitting import fit_focal_error, fit_model, models_text
from dgc_pose.benchmarks.probability.plan import PlanEntry
from dgc_pose.benchmarks.probability.records import Record, records
from dgc_pose.benchmarks.probability.report import judged, reliability_figure, report_text
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import MatchKind, match_kind, parse_models

_DEFAULTS = EstimationOptions()
WORDS = {
    "network": "matches of a network, with its dense map",
    "matches": "the same matches without the map",
    "key_points": "key points",
    "network_auto": "matches of a network, K withheld",
    "matches_auto": "the same without the map, K withheld",
}


def fit_all(
    out: Path,
    methods: Sequence[str],
    entries: Sequence[PlanEntry],
    options: EstimationOptions = _DEFAULTS,
) -> tuple[str, str, Figure]:
    """Fit a model for each kind of matches that the methods make.

    options: of the estimation, as users have them. Returns `probability.json`, the report, and its
    figure. Raises InputError if nothing is stored, or too little.
    """
    engines = {method: read_engine(out, method) for method in methods}
    by_kind: dict[MatchKind, list[Record]] = {}
    for method in methods:
        of_method = list(records(read_collection(out, method, entries), options))
        for kind, rows in _by_kind(of_method).items():
            by_kind.setdefault(kind, rows)  # of several networks the first
    if not by_kind:
        raise InputError(f"{out}: no pose was found in any stored pair")
    focal_error = fit_focal_error([row for rows in by_kind.values() for row in rows])
    fitted = {kind: fit_model(rows, kind) for kind, rows in by_kind.items()}
    text = models_text(fitted, focal_error, engines)
    models, focal = parse_models(text)
    reported = {
        kind: [judged(row, models[kind], focal) for row in rows if row.entry.part == "report"]
        for kind, rows in by_kind.items()
    }
    parts = [f"{WORDS[kind]}\n\n{report_text(rows)}" for kind, rows in reported.items()]
    figure = reliability_figure({str(kind): rows for kind, rows in reported.items()})
    return text, "\n\n\n".join(parts), figure


def _kind(evidence: Evidence) -> MatchKind:
    return match_kind(
        key_points=evidence.key_points,
        with_map=evidence.map_agreement is not None,
        fitted=evidence.jackknife_focal_90_percent is not None,
    )


def _by_kind(rows: Sequence[Record]) -> dict[MatchKind, list[Record]]:
    """A method's records by their kind of matches and cameras, and a network's as those of no map
    too. Those without evidence are of every kind of their cameras."""
    blank = {"map_matchability": None, "map_agreement": None, "map_chance": None}
    kinds: dict[MatchKind, list[Record]] = {}
    for auto in (False, True):
        members = [row for row in rows if (row.cameras == "auto") == auto]
        kind = {_kind(row.evidence) for row in members if row.evidence is not None}
        for name in kind:
            kinds[name] = members
        if "network" in kind or "network_auto" in kind:
            evidence = [row.evidence and replace(row.evidence, **blank) for row in members]  # type: ignore[arg-type]
            without = [replace(row, evidence=e) for row, e in zip(members, evidence, strict=True)]
            kinds["matches_auto" if auto else "matches"] = without
    return kinds
