"""Whether the model for key points holds for matchers that it is not fitted on."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dgc_pose.benchmarks.probability.fitting import fit_model, fit_same_place
from dgc_pose.benchmarks.probability.judging import Judged, judged
from dgc_pose.benchmarks.probability.records import Record
from dgc_pose.estimation.probability import MatchKind, ProbabilityModel, parse_models
from dgc_pose.system.texts import aligned

_EDGES = (0.5, 0.8, 0.95, 1.0)  # of the probabilities in the table
_FOLDS = 4  # of the scenes of the fit
_NONE = "-"  # no matcher


def generality_text(rows: Mapping[str, Sequence[Record]], kind: MatchKind) -> str:
    """A table of the claims for each matcher, by models fitted on all matchers of key points and
    without one of them. rows: the records by matcher.

    "report": of the part `report`. "scenes": of the part `fit`, by models fitted on other scenes.
    The last rows are of all matchers together, each by the model fitted without it or with it.
    """
    fitted_on = [name for name in rows if are_key_points(rows[name])]
    others = [name for name in rows if name not in fitted_on]
    bins = [f"{low:g} to {high:g}" for low, high in zip(_EDGES, _EDGES[1:], strict=False)]
    heading = ("matches of", "fitted without", "on", "pairs", *bins, "claims", "wrong", "R", "t")
    table = [heading]
    joined = dict[tuple[str, str], list[Judged]]()
    for left_out in (_NONE, *fitted_on):
        fitted = [row for name in fitted_on if name != left_out for row in rows[name]]
        models_by_part = {"report": [fit_model(fitted, kind)], "scenes": _by_fold(fitted, kind)}
        own = fitted_on if left_out == _NONE else [left_out]
        for name in (*own, *others):
            for part, models in models_by_part.items():
                fitted_models = [one_place(values, kind) for values in models]
                poses = _judged(rows[name], part, fitted_models)
                table.append((name, left_out, part, *_cells(poses)))
                if name in own:
                    without = _NONE if left_out == _NONE else "each"
                    joined.setdefault((without, part), []).extend(poses)
    table += [("all", without, part, *_cells(poses)) for (without, part), poses in joined.items()]
    return aligned(table)


def are_key_points(rows: Iterable[Record]) -> bool:
    """Whether the matches of a matcher are key points."""
    return any(row.evidence is not None and row.evidence.key_points for row in rows)


def one_place(fields: Mapping[str, Any], kind: MatchKind) -> ProbabilityModel:
    """The model of `fit_model`, certain that images show one place."""
    certain = fit_same_place(np.zeros(0), np.zeros(0, bool))
    focal_error = {"slope": 0.0, "intercept": 0.0}
    data = {"engine": {}, "focal_error": focal_error, "same_place": certain}
    return parse_models(json.dumps({**data, "models": {kind: fields}})).by_kind[kind]


def _by_fold(rows: Sequence[Record], kind: MatchKind) -> list[dict[str, Any]]:
    """The model fitted without the scenes of each fold."""
    return [fit_model([r for r in rows if _fold(r) != fold], kind) for fold in range(_FOLDS)]


def _fold(row: Record) -> int:
    return sum(row.scene.encode()) % _FOLDS


def _judged(rows: Iterable[Record], part: str, models: Sequence[ProbabilityModel]) -> list[Judged]:
    if part == "report":
        return [judged(row, models[0]) for row in rows if row.entry.part == "report"]
    return [judged(row, models[_fold(row)]) for row in rows if row.entry.part == "fit"]


def _cells(poses: Sequence[Judged]) -> tuple[str, ...]:
    """The cells of a row: in each bin the mean probability and the share of right poses."""
    probability = np.array([pose.probability for pose in poses])
    right = np.array([pose.right for pose in poses], bool)
    claimed = np.array([pose.by_probability for pose in poses], bool)
    bins = []
    for low, high in zip(_EDGES, _EDGES[1:], strict=False):
        own = (probability >= low) & (probability < high)
        mean, share = (100 * v[own].mean() if own.any() else np.nan for v in (probability, right))
        bins.append(f"{own.sum()}: {mean:.0f} -> {share:.0f} %" if own.any() else "-")
    wrong = int((claimed & ~right).sum())
    share = 100 * wrong / max(claimed.sum(), 1)
    exact = [p for p in poses if p.by_probability and p.right and p.record.exact]
    R = [p.record.best.rotation_error_deg <= p.rotation_90_deg for p in exact]
    t = [p.record.best.translation_error_deg <= p.translation_90_deg for p in exact]
    held = [f"{100 * np.mean(part):.0f} %" if exact else "-" for part in (R, t)]
    return (str(len(poses)), *bins, str(claimed.sum()), f"{wrong} ({share:.1f} %)", *held)
