"""The fit from collected records, and its evaluation on scenes outside of the fit."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.benchmarks.probability.fitting import (
    fit_focal_error,
    fit_lines,
    fit_model,
    fit_same_place,
)
from dgc_pose.benchmarks.probability.generality import (
    are_key_points,
    generality_text,
    one_place,
)
from dgc_pose.benchmarks.probability.judging import Judged, judged
from dgc_pose.benchmarks.probability.planned import PlanEntry
from dgc_pose.benchmarks.probability.records import Record, records
from dgc_pose.benchmarks.report import calibration_error, reliability, shares
from dgc_pose.errors import InputError
from dgc_pose.estimation.probability import (
    FORMAT,
    MatchKind,
    match_kind,
    parse_models,
    shipped_text,
)
from dgc_pose.system.texts import aligned
from dgc_pose.viz.figure import new_figure

_KINDS: dict[MatchKind, str] = {
    "network": "matches of a network, with its dense map",
    "matches": "the same matches without the map",
    "network_auto": "matches of a network, K withheld",
    "matches_auto": "the same without the map, K withheld",
    "key_points": "key points",
    "key_points_auto": "key points, K withheld",
}


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
        right = sum(p.right for p in members)
        wrong = sum(not p.right for p in claims)
        share = f" ({100 * wrong / len(claims):.1f} %)" if claims else ""
        mean = f"{100 * np.mean([p.probability for p in claims]):.1f} %" if claims else "-"
        counts = len(members), right, len(claims), f"{wrong}{share}", right - len(claims) + wrong
        rows.append((name, *map(str, (*counts, sum(p.ambiguous for p in members), mean))))
    return aligned(rows)


def _calibration(poses: Sequence[Judged]) -> np.ndarray:
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
    settings: Mapping[str, Mapping[str, Any]],
    entries: Sequence[PlanEntry],
) -> tuple[str, str, Figure]:
    """Fit a model for each kind of matches that the methods make.

    pieces: results of `collect`; settings: of their run, by name the networks ("engines") and the
    other matchers ("others"). Returns `probability.json`, the report and its figure. With
    others alone, the models of networks stay as in the package; without others, those of key
    points. Raises InputError if there are too few poses.
    """
    order = {entry.name: number for number, entry in enumerate(entries)}
    pieces = sorted(
        (piece for piece in pieces if piece["entry"] in order),
        key=lambda piece: (order[piece["entry"]], piece["number"]),
    )
    used: dict[str, Any] = {}
    by_kind: dict[MatchKind, list[Record]] = {}
    for method, engine in settings["engines"].items():
        kinds = _by_kind(records(pieces, method, entries))
        if kinds.keys() - by_kind.keys():  # of several networks, the first is used
            used[method] = engine
        by_kind = {**kinds, **by_kind}
    by_matcher = _by_matcher(pieces, settings["others"], entries)
    joined = {
        kind: [*chain(*(members for members in rows.values() if are_key_points(members)))]
        for kind, rows in by_matcher.items()
    }
    if not by_kind and not joined:
        raise InputError("no pose was found in any pair")
    data = json.loads(shipped_text())
    kept = ("key_points", "key_points_auto") if by_kind else [*_KINDS]
    models = {kind: fields for kind, fields in data["models"].items() if kind in kept}
    if by_kind:
        fitted = {kind: fit_model(rows, kind) for kind, rows in by_kind.items()}
        data |= {
            "format": FORMAT,
            "engine": used,
            "focal_error": fit_focal_error([row for rows in by_kind.values() for row in rows]),
            "same_place": _fit_place(by_kind.get("network", []), fitted),
        }
        models = {**fitted, **models}
    for kind, rows in joined.items():
        tested = [name for name, own in by_matcher[kind].items() if are_key_points(own)]
        models[kind] = {**fit_model(rows, kind), "tested": tested}
    data["models"] = models
    text = json.dumps(data, indent=1) + "\n"
    parsed = parse_models(text).by_kind
    reported = {
        kind: [judged(row, parsed[kind]) for row in rows if row.entry.part == "report"]
        for kind, rows in {**by_kind, **joined}.items()
    }
    parts = [f"{_KINDS[kind]}\n\n{report_text(rows)}" for kind, rows in reported.items()]
    parts += [
        f"{_KINDS[kind]}, by matcher\n\n{generality_text(rows, kind)}"
        for kind, rows in by_matcher.items()
    ]
    lines = f"lines of the images: {fit_lines(pieces)}"
    return text, "\n\n\n".join([*parts, lines]), plot_reliability(reported)


def _fit_place(rows: Sequence[Record], fitted: Mapping[MatchKind, Any]) -> dict[str, float]:
    """The `SamePlace` of a network's records, by the claims of its model."""
    claims = [judged(row, one_place(fitted["network"], "network")) for row in rows]
    known = []
    for claim in claims:
        record = claim.record
        is_known = claim.right or record.entry.kind == "pasted"
        if record.entry.part != "fit" or not (claim.by_probability and is_known):
            continue
        if record.evidence is not None and record.evidence.context_ratio is not None:
            known.append((record.evidence.context_ratio, claim.right))
    around, right = np.array(known, float).reshape(-1, 2).T
    return fit_same_place(around, right > 0)


def _by_kind(rows: Sequence[Record]) -> dict[MatchKind, list[Record]]:
    """A network's records by kind of matches and cameras, also without their map. A record without
    evidence belongs to every kind with its cameras."""
    kinds: dict[MatchKind, list[Record]] = {}
    for cameras in ("exact", "auto"):
        members = [row for row in rows if row.cameras == cameras]
        known = [row.evidence for row in members if row.evidence is not None]
        for with_map in {e.map_agreement is not None for e in known}:
            kind = match_kind(key_points=False, with_map=with_map, fitted=cameras == "auto")
            kinds[kind] = members
            if with_map:
                kind = match_kind(key_points=False, with_map=False, fitted=cameras == "auto")
                kinds[kind] = _without_map(members)
    return kinds


def _by_matcher(
    pieces: Sequence[Mapping[str, Any]], names: Iterable[str], entries: Sequence[PlanEntry]
) -> dict[MatchKind, dict[str, list[Record]]]:
    """The records of the matchers that are no network, by kind and matcher, without their map."""
    by_name = {name: _without_map(records(pieces, name, entries)) for name in names}
    kinds: dict[MatchKind, dict[str, list[Record]]] = {}
    for cameras in ("exact", "auto"):
        own = {name: [r for r in rows if r.cameras == cameras] for name, rows in by_name.items()}
        if any(map(are_key_points, own.values())):
            kind = match_kind(key_points=True, with_map=False, fitted=cameras == "auto")
            kinds[kind] = own
    return kinds


def _without_map(rows: Iterable[Record]) -> list[Record]:
    none = {"map_matchability": None, "map_agreement": None, "map_chance": None}
    return [
        replace(row, evidence=row.evidence and replace(row.evidence, **none))  # type: ignore[arg-type]
        for row in rows
    ]
