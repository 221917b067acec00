"""The verdict of a fitted model on a record."""

import math
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.benchmarks.probability.records import Record
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.probability import (
    ProbabilityModel,
    bound_if_right,
    choice_shares,
    utility,
)
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.verdict import judge


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
    shares = choice_shares(utilities, model.choice["lapse"])
    order = np.argsort(-shares, kind="stable")
    share = float(shares[order[0]])
    rotation, translation = model.errors_90_deg(evidence)
    same_place = model.same_place.probability(evidence)
    verdict = judge(
        *(evidence, EstimationOptions().min_probability, any_right, (), shares[order].tolist()),
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
