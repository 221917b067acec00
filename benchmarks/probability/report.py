"""The fit from collected records, and its evaluation on scenes outside of the fit."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.benchmarks.probability.fitting import (
    fit_focal_error,
    fit_lines,
    fit_model,
    fit_same_place,
)
from dgc_pose.benchmarks.probability.planned import PlanEntry
from dgc_pose.benchmarks.probability.records import Record, records
from dgc_pose.benchmarks.report import calibration_error, reliability, shares
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.probability import (
    FORMAT,
    MatchKind,
    ProbabilityModel,
    bound_if_right,
    choice_shares,
    match_kind,
    parse_models,
    utility,
)
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.verdict import judge
from dgc_pose.system.texts import aligned
from dgc_pose.viz.figure import new_figure

_KINDS: dict[MatchKind, str] = {
    "network": "matches of a network, with its dense map",
    "matches": "the same matches without the map",
    "key_points": "key points",
    "network_auto": "matches of a network, K withheld",
    "matches_auto": "the same without the map, K withheld",
}


@dataclass(frozen=True, eq=False)
class Judged:
    """A record with the verdict of the fitted model."""

    record: Record
    by_probability: bool
    probability: float  # 0 if the evidence does not determine the translation
    rotation_90_deg: float
    translation_90_deg: float
    ambiguous: bool = False

    @property
    def right(self) -> bool:
        return self.record.best.right


def judged(record: Record, model: ProbabilityModel) -> Judged:
    """The verdict of a model on a record."""
    evidence = record.evidence
    if evidence is None:
        return Judged(record, False, 0.0, math.nan, math.nan)
    any_right = model.probability(evidence)
    utilities = [utility(p.likelihood, p.map_agreement, model.choice) for p in record.poses]
    of_poses = choice_shares(utilities, model.choice["lapse"])
    order = np.argsort(-of_poses, kind="stable")
    share = float(of_poses[order[0]])
    rotation, translation = model.errors_90_deg(evidence)
    same_place = model.same_place.probability(evidence)
    verdict = judge(
        *(evidence, EstimationOptions().min_probability, any_right, (), of_poses[order].tolist()),
        same_place,
    )
    known = STATUSES[verdict.status]
    return Judged(
        replace(record, poses=tuple(record.poses[k] for k in order)),
        known.has_t,
        0.0 if verdict.status == "rotation_only" else same_place * share * any_right,
        bound_if_right(rotation),
        bound_if_right(translation),
        verdict.status == "ambiguous",
    )


def report_text(poses: Sequence[Judged]) -> str:
    """A report on the claims for poses outside of the fit, and on their accuracy."""
    error = 100 * calibration_error(_calibration(poses))
    exact = [p for p in poses if p.by_probability and p.right and p.record.exact]
    R = [p.record.best.rotation_error_deg <= p.rotation_90_deg for p in exact]
    t = [p.record.best.translation_error_deg <= p.translation_90_deg for p in exact]
    within = f"{100 * np.mean(R):.0f} and {100 * np.mean(t):.0f} %" if exact else "none"
    return (
        "Claimed and rejected, by data set. A pose is right within 10 degrees in R and t.\n\n"
        f"{claims_table(poses)}\n\ncalibration error of the probability {error:.1f} %\n"
        "right claimed poses whose R and t are within the expected error (90 % expected, "
        f"without scenes of a rough reference): {within} of {len(exact)}"
    )


def claims_table(poses: Sequence[Judged]) -> str:
    """A table with a row for each data set, and one for all."""
    headings = ("pairs", "number", "right", "claimed", "wrong", "missed", "ambiguous")
    rows: list[tuple[str, ...]] = [(*headings, "mean of claims")]
    groups: dict[str, list[Judged]] = {}
    for pose in poses:
        groups.setdefault(pose.record.entry.name, []).append(pose)
    for name, members in {**groups, "all": poses}.items():
        claims = [pose for pose in members if pose.by_probability]
        right, wrong = sum(p.right for p in members), sum(not p.right for p in claims)
        share = f" ({100 * wrong / len(claims):.1f} %)" if claims else ""
        mean = f"{100 * np.mean([p.probability for p in claims]):.1f} %" if claims else "-"
        counts = len(members), right, len(claims), f"{wrong}{share}", right - len(claims) + wrong
        rows.append((name, *map(str, (*counts, sum(p.ambiguous for p in members), mean))))
    return aligned(rows)


def _calibration(poses: Sequence[Judged]) -> np.ndarray:
    """`reliability` of the probability, over the poses with evidence."""
    known = [pose for pose in poses if pose.record.evidence is not None]
    right = np.array([pose.right for pose in known], bool)
    return reliability(np.array([pose.probability for pose in known]), right)


def plot_reliability(reported: Mapping[MatchKind, Sequence[Judged]]) -> Figure:
    """Plot the share of right poses by bin of probability, a curve for each kind of matches."""
    figure = new_figure(5.5, 5)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="grey", linestyle="--", linewidth=1)
    for kind, poses in reported.items():
        counts = _calibration(poses)
        share, probability = shares(counts[:, counts[0] > 0])
        label = f"{kind}, calibration error {100 * calibration_error(counts):.1f} %"
        axes.plot(probability, share, marker="o", ms=4, label=label)
    words = "share of poses within 10 degrees"
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="probability", ylabel=words)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize=9)
    return figure


def fit_all(
    pieces: Sequence[Mapping[str, Any]],
    engines: Mapping[str, Any],
    entries: Sequence[PlanEntry],
) -> tuple[str, str, Figure]:
    """Fit a model for each kind of matches that the methods make.

    pieces: results of `collect`; engines: name and fingerprint of each method's matcher. Returns
    `probability.json`, the report and its figure. Raises InputError if there are too few poses.
    """
    order = {entry.name: number for number, entry in enumerate(entries)}
    pieces = sorted(
        (piece for piece in pieces if piece["entry"] in order),
        key=lambda piece: (order[piece["entry"]], piece["number"]),
    )
    used: dict[str, Any] = {}
    by_kind: dict[MatchKind, list[Record]] = {}
    for method, engine in engines.items():
        kinds = _by_kind(records(pieces, method, entries))
        if kinds.keys() - by_kind.keys():  # of several networks, the first is used
            used[method] = engine
        by_kind = {**kinds, **by_kind}
    if not by_kind:
        raise InputError("no pose was found in any pair")
    of_images = fit_lines(pieces)
    focal_error = fit_focal_error([row for rows in by_kind.values() for row in rows])
    fitted = {kind: fit_model(rows, kind) for kind, rows in by_kind.items()}
    data = {"format": FORMAT, "engine": used, "focal_error": focal_error}
    certain = fit_same_place(np.zeros(0), np.zeros(0, bool))
    one_place = parse_models(json.dumps({**data, "same_place": certain, "models": fitted})).by_kind
    claims = [judged(row, one_place["network"]) for row in by_kind.get("network", [])]
    known = [
        (claim.record.evidence.context_ratio, claim.right)
        for claim in claims
        if claim.by_probability
        and claim.record.entry.part == "fit"
        and (claim.right or claim.record.entry.kind == "pasted")
        and claim.record.evidence is not None
        and claim.record.evidence.context_ratio is not None
    ]
    around, right = np.array(known, float).reshape(-1, 2).T
    data |= {"same_place": fit_same_place(around, right > 0), "models": fitted}
    text = json.dumps(data, indent=1) + "\n"
    models = parse_models(text).by_kind
    reported = {
        kind: [judged(row, models[kind]) for row in rows if row.entry.part == "report"]
        for kind, rows in by_kind.items()
    }
    parts = [f"{_KINDS[kind]}\n\n{report_text(rows)}" for kind, rows in reported.items()]
    lines = f"lines of the images: {of_images}"
    return text, "\n\n\n".join([*parts, lines]), plot_reliability(reported)


def _by_kind(rows: Sequence[Record]) -> dict[MatchKind, list[Record]]:
    """A method's records by kind of matches and cameras; a network's also without their map. A
    record without evidence belongs to every kind with its cameras."""
    blank = {"map_matchability": None, "map_agreement": None, "map_chance": None}
    kinds: dict[MatchKind, list[Record]] = {}
    for cameras in ("exact", "auto"):
        members = [row for row in rows if row.cameras == cameras]
        known = [row.evidence for row in members if row.evidence is not None]
        for key_points, with_map in {(e.key_points, e.map_agreement is not None) for e in known}:
            of = {"key_points": key_points, "fitted": cameras == "auto"}
            kinds[match_kind(with_map=with_map, **of)] = members
            if with_map:
                without = [e and replace(e, **blank) for e in (row.evidence for row in members)]  # type: ignore[arg-type]
                pairs = zip(members, without, strict=True)
                kinds[match_kind(with_map=False, **of)] = [replace(r, evidence=e) for r, e in pairs]
    return kinds
