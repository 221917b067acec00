"""The fit from stored matches, and what it is worth on scenes that have no part in it."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.benchmarks.probability.collection import read_collection, read_engine
from dgc_pose.benchmarks.probability.fitting import fit_focal_error, fit_model
from dgc_pose.benchmarks.probability.plan import PlanEntry
from dgc_pose.benchmarks.probability.records import Record, records
from dgc_pose.benchmarks.reliability import Reliability, draw_reliability
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import (
    FORMAT,
    MatchKind,
    ProbabilityModel,
    choice_shares,
    match_kind,
    of_right,
    parse_models,
    utility,
)
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.verdict import judge
from dgc_pose.files.tables import aligned

_DEFAULTS = EstimationOptions()
_KINDS: dict[MatchKind, str] = {
    "network": "matches of a network, with its dense map",
    "matches": "the same matches without the map",
    "key_points": "key points",
    "network_auto": "matches of a network, K withheld",
    "matches_auto": "the same without the map, K withheld",
}


@dataclass(frozen=True, eq=False)
class Judged:
    """A record with what is claimed of it."""

    record: Record
    by_probability: bool
    probability: float  # 0 if by the evidence the translation is not determined
    rotation_90_deg: float
    translation_90_deg: float
    ambiguous: bool = False

    @property
    def right(self) -> bool:
        return self.record.right


def judged(record: Record, model: ProbabilityModel) -> Judged:
    """The verdict on a record, by the probability."""
    evidence = record.evidence
    if evidence is None:
        return Judged(record, False, 0.0, math.nan, math.nan)
    any_right = model.probability(evidence)
    shares = choice_shares(
        [utility(p.likelihood, p.map_agreement, model.choice) for p in record.poses],
        model.choice["lapse"],
    )
    order = np.argsort(-shares, kind="stable")
    share, best = float(shares[order[0]]), record.poses[order[0]]
    rotation, translation = model.errors_90_deg(evidence)
    verdict = judge(
        evidence, EstimationOptions().min_probability, any_right, (), shares[order].tolist()
    )
    known = STATUSES[verdict.status]
    return Judged(
        replace(
            record,
            rotation_error_deg=best.rotation_error_deg,
            translation_error_deg=best.translation_error_deg,
        ),
        known.has_t,
        0.0 if verdict.status == "rotation_only" else share * any_right,
        of_right(rotation),
        of_right(translation),
        verdict.status == "ambiguous",
    )


def report_text(poses: Sequence[Judged]) -> str:
    """The claims on scenes that have no part in the fit, and what they are worth."""
    error = 100 * reliability(poses).calibration_error
    exact = [p for p in poses if p.by_probability and p.right and p.record.exact]
    R = [p.record.rotation_error_deg <= p.rotation_90_deg for p in exact]
    t = [p.record.translation_error_deg <= p.translation_90_deg for p in exact]
    within = f"{100 * np.mean(R):.0f} and {100 * np.mean(t):.0f} %" if exact else "none"
    return (
        "Claimed and refused, by data set. A pose is right within 10 degrees in R and t.\n\n"
        f"{claims_table(poses)}\n\ncalibration error of the probability {error:.1f} %\n"
        "right claimed poses whose R and t are within the expected error, 90 % of them meant, "
        f"scenes of a rough reference left out: {within} of {len(exact)}"
    )


def claims_table(poses: Sequence[Judged]) -> str:
    """A row a data set, and all of them."""
    headings = ("pairs", "number", "right", "claimed", "wrong", "right refused", "ambiguous")
    rows: list[tuple[str, ...]] = [(*headings, "mean of claims")]
    for name, members in _groups(poses).items():
        right = _values(members, "right")
        claims = _values(members, "by_probability")
        claimed, wrong = int(claims.sum()), int((claims & ~right).sum())
        share = f" ({100 * wrong / claimed:.1f} %)" if claimed else ""
        cells = [str(claimed), f"{wrong}{share}", str((~claims & right).sum())]
        probability = _values(members, "probability")[claims]
        cells += [str(_values(members, "ambiguous").sum())]
        cells += [f"{100 * probability.mean():.1f} %" if len(probability) else "-"]
        rows.append((name, str(len(members)), str(right.sum()), *cells))
    return aligned(rows)


def reliability(poses: Sequence[Judged]) -> Reliability:
    """Of the probability of the poses that have evidence."""
    known = [pose for pose in poses if pose.record.evidence is not None]
    return Reliability.of(_values(known, "probability"), _values(known, "right"))


def reliability_figure(kinds: Mapping[str, Sequence[Judged]]) -> Figure:
    """The reliability diagram, a curve a kind of matches."""
    from dgc_pose.viz.figure import new_figure

    figure = new_figure(5.5, 5)
    axes = figure.subplots()
    curves = {name: reliability(poses) for name, poses in kinds.items()}
    draw_reliability(axes, curves, right="within 10 degrees")
    axes.set(xlabel="probability", ylabel="share of poses within 10 degrees")
    return figure


def _values(poses: Sequence[Judged], name: str) -> np.ndarray:
    kind = float if name == "probability" else bool
    return np.array([getattr(pose, name) for pose in poses], kind)


def _groups(poses: Sequence[Judged]) -> dict[str, list[Judged]]:
    groups: dict[str, list[Judged]] = {}
    for pose in poses:
        groups.setdefault(pose.record.entry.name, []).append(pose)
    return {**groups, "all": list(poses)}


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
    engines: dict[str, Any] = {}
    by_kind: dict[MatchKind, list[Record]] = {}
    for method in methods:
        engine = read_engine(out, method)
        kinds = _by_kind(list(records(read_collection(out, method, entries), options)))
        if kinds.keys() - by_kind.keys():  # of several networks the first
            engines[method] = engine
        by_kind = {**kinds, **by_kind}
    if not by_kind:
        raise InputError(f"{out}: no pose was found in any stored pair")
    focal_error = fit_focal_error([row for rows in by_kind.values() for row in rows])
    fitted = {kind: fit_model(rows, kind) for kind, rows in by_kind.items()}
    data = {"format": FORMAT, "engine": engines, "focal_error": focal_error, "models": fitted}
    text = json.dumps(data, indent=1) + "\n"
    models = parse_models(text).by_kind
    reported = {
        kind: [judged(row, models[kind]) for row in rows if row.entry.part == "report"]
        for kind, rows in by_kind.items()
    }
    parts = [f"{_KINDS[kind]}\n\n{report_text(rows)}" for kind, rows in reported.items()]
    figure = reliability_figure({str(kind): rows for kind, rows in reported.items()})
    return text, "\n\n\n".join(parts), figure


def _kind(evidence: Evidence) -> MatchKind:
    return match_kind(
        key_points=evidence.key_points,
        with_map=evidence.map_agreement is not None,
        fitted=evidence.raw_focal_90_percent is not None,
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
