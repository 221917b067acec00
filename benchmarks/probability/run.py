"""Fit, calibration and report in one go, from stored matches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib.figure import Figure

from dgc_pose.benchmarks.probability.collection import read_collection, read_engine
from dgc_pose.benchmarks.probability.fitting import fit_model, models_text
from dgc_pose.benchmarks.probability.plan import Source
from dgc_pose.benchmarks.probability.records import Record, records
from dgc_pose.benchmarks.probability.report import (
    Judged,
    judged,
    reliability_figure,
    report_text,
)
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.probability import MatchKind, match_kind, models_of

_DEFAULTS = EstimationOptions()
WORDS = {
    "network": "matches of a network, with its dense map",
    "matches": "the same matches without the map",
    "key_points": "key points",
}


@dataclass(frozen=True)
class Fitted:
    """What a fit writes."""

    models: str  # JSON
    report: str
    figure: Figure
    records: Sequence[Record]  # of all pairs and methods


def fit_all(
    out: Path,
    methods: Sequence[str],
    sources: Sequence[Source],
    options: EstimationOptions = _DEFAULTS,
    say: Callable[[str], object] = lambda line: None,
) -> Fitted:
    """A model for each kind of matches that the methods make, and the report.

    options: of the estimation, as users have them. say: takes a line of progress. Raises InputError
    if nothing is stored, or too little.
    """
    engine = {method: read_engine(out, method) for method in methods}
    by_kind: dict[MatchKind, list[Record]] = {}
    for method in methods:
        found = list(records(read_collection(out, method, sources), options))
        say(f"{method}: {len(found)} pairs")
        for kind, own in _by_kind(found).items():
            by_kind.setdefault(kind, own)  # of several networks the first
    if not by_kind:
        raise InputError(f"{out}: no pose was found in any stored pair")
    fitted = {kind: fit_model(own, kind) for kind, own in by_kind.items()}
    text = models_text(fitted, engine)
    models = models_of(text, "the fit")
    reported: dict[str, list[Judged]] = {
        kind: [judged(one, models[kind]) for one in own if one.part == "report"]
        for kind, own in by_kind.items()
    }
    parts = [f"{WORDS[kind]}\n\n{report_text(own)}" for kind, own in reported.items()]
    everything = [one for own in by_kind.values() for one in own]
    return Fitted(text, "\n\n\n".join(parts), reliability_figure(reported), everything)


def _by_kind(found: Sequence[Record]) -> dict[MatchKind, list[Record]]:
    """A method's records as its own kind of matches, and a network's as those of no map too."""
    kinds = {match_kind(one.evidence) for one in found if one.evidence is not None}
    if "network" not in kinds:
        return {kind: list(found) for kind in kinds}
    return {"network": list(found), "matches": [_without_map(one) for one in found]}


def _without_map(record: Record) -> Record:
    if record.evidence is None:
        return record
    blank = dict.fromkeys(("map_matchability", "map_agreement", "map_chance"))
    return replace(record, evidence=replace(record.evidence, **blank))  # type: ignore[arg-type]
