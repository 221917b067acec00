"""What a probability is worth on scenes that nothing was fitted on, beside the old gates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.benchmarks.probability.records import Record
from dgc_pose.benchmarks.table import aligned
from dgc_pose.estimation import VerdictOptions
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import ProbabilityModel
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.verdict import judge
from dgc_pose.metrics import Reliability, pose_auc

_GATES = VerdictOptions(min_probability=None)
_ROTATIONS = (0, 15, 30, 45, 180)  # degrees, edges of bins
_INLIERS = (0, 60, 200, 600, math.inf)
_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99)


@dataclass(frozen=True, eq=False)
class Judged:
    """A record with what is claimed of it."""

    record: Record
    by_gates: bool
    by_probability: bool
    probability: float  # 0 if the evidence says that the translation is not determined
    rotation_90_deg: float
    translation_90_deg: float


def judged(record: Record, model: ProbabilityModel, min_probability: float = 0.5) -> Judged:
    """The verdicts on a record, by the gates and by the probability."""
    evidence = record.evidence
    if evidence is None:
        return Judged(record, False, False, 0.0, math.nan, math.nan)
    options = VerdictOptions(min_probability=min_probability)
    probability = model.probability(evidence)
    status = judge(evidence, options, probability).status
    return Judged(
        record,
        STATUSES[judge(evidence, _GATES).status].has_t,
        STATUSES[status].has_t,
        0.0 if STATUSES[status].rotation_alone else probability,
        _expected(evidence, model, "rotation"),
        _expected(evidence, model, "translation"),
    )


def report_text(found: Sequence[Judged]) -> str:
    """All tables."""
    parts = [
        "Claimed and refused, by data set. A pose is right within 10 degrees in R and t.",
        claims_table(found),
        "AUC@5/10/20 with the verdict, and with every pair answered (true pairs alone)",
        auc_table(found),
        f"calibration error of the probability {100 * reliability(found).calibration_error:.1f} %",
        reliability_table(found),
        "precision and recall of right poses by the least probability",
        levels_table(found),
        "share of right claimed poses whose error is within the expected one, 90 % of them meant; "
        "scenes of a rough reference left out",
        coverage_table(found),
    ]
    return "\n\n".join(parts)


def claims_table(found: Sequence[Judged]) -> str:
    """A row a data set, and all of them."""
    rows: list[tuple[str, ...]] = [
        ("pairs", "number", "right", "gates claim", "wrong", "right refused", "probability claims")
        + ("wrong", "right refused")
    ]
    for name, own in _groups(found).items():
        right = sum(one.record.right for one in own)
        cells = []
        for claims in ([o.by_gates for o in own], [o.by_probability for o in own]):
            wrong = sum(c and not o.record.right for c, o in zip(claims, own, strict=True))
            refused = sum(not c and o.record.right for c, o in zip(claims, own, strict=True))
            share = f" ({100 * wrong / sum(claims):.1f} %)" if sum(claims) else ""
            cells += [str(sum(claims)), f"{wrong}{share}", str(refused)]
        rows.append((name, str(len(own)), str(right), *cells))
    return aligned(rows)


def auc_table(found: Sequence[Judged]) -> str:
    """With the gates, with the probability, and without a verdict."""
    rows: list[tuple[str, ...]] = [("pairs", "gates", "probability", "all answered")]
    for name, own in _groups(found).items():
        errors = np.array([one.record.pair_error_deg for one in own])
        if not np.isfinite(errors).any():
            continue
        claims = (
            [one.by_gates for one in own],
            [one.by_probability for one in own],
            [True] * len(own),
        )
        cells = (pose_auc(np.where(claim, errors, np.inf)) for claim in claims)
        rows.append((name, *("/".join(f"{a:.1f}" for a in auc) for auc in cells)))
    return aligned(rows)


def reliability(found: Sequence[Judged]) -> Reliability:
    """Of the probability of the records that have evidence."""
    own = [one for one in found if one.record.evidence is not None]
    return Reliability.of(
        np.array([one.probability for one in own]), np.array([one.record.right for one in own])
    )


def reliability_table(found: Sequence[Judged]) -> str:
    own = reliability(found)
    rows = [("probability", "poses", "mean", "right")]
    bins = zip(own.edges, own.counts, own.mean_confidence, own.share_correct, strict=False)
    for low, count, mean, right in bins:
        if count:
            name = f"{low:.1f} to {low + 0.1:.1f}"
            rows.append((name, str(count), f"{100 * mean:.0f} %", f"{100 * right:.0f} %"))
    return aligned(rows)


def levels_table(found: Sequence[Judged]) -> str:
    """Precision and recall at several least probabilities, and of the gates."""
    rows = [("least probability", "claimed", "precision", "recall")]
    right = np.array([one.record.right for one in found])
    probability = np.array([one.probability for one in found])
    claims = [(f"{level:g}", probability >= level) for level in _LEVELS]
    claims.append(("gates", np.array([one.by_gates for one in found])))
    for name, claimed in claims:
        true = int((claimed & right).sum())
        precision = f"{100 * true / claimed.sum():.1f} %" if claimed.any() else "-"
        rows.append((name, str(claimed.sum()), precision, f"{100 * true / right.sum():.1f} %"))
    return aligned(rows)


def coverage_table(found: Sequence[Judged]) -> str:
    """By bins of rotation and of inliers."""
    own = [one for one in found if one.by_probability and one.record.right and one.record.exact]
    rows = [("poses", "number", "R within", "t within")]
    bins = {"all": own}
    for low, high in zip(_ROTATIONS, _ROTATIONS[1:], strict=False):
        bins[f"rotation {low} to {high} deg"] = [
            one for one in own if low <= _evidence(one).rotation_angle_deg < high
        ]
    for less, more in zip(_INLIERS, _INLIERS[1:], strict=False):
        bins[f"inliers {less:.0f} to {more:.0f}"] = [
            one for one in own if less <= _evidence(one).num_inliers < more
        ]
    for name, some in bins.items():
        if some:
            R = np.mean([one.record.rotation_error_deg <= one.rotation_90_deg for one in some])
            t = np.mean(
                [one.record.translation_error_deg <= one.translation_90_deg for one in some]
            )
            rows.append((name, str(len(some)), f"{100 * R:.0f} %", f"{100 * t:.0f} %"))
    return aligned(rows)


def reliability_figure(found: Mapping[str, Sequence[Judged]]) -> Figure:
    """The reliability diagram and precision against recall, a curve a kind of matches; the gates
    are a point each."""
    from dgc_pose.viz.curves import draw_reliability
    from dgc_pose.viz.figure import new_figure

    figure = new_figure(11, 5)
    left, other = figure.subplots(1, 2)
    curves = {name: reliability(own) for name, own in found.items()}
    draw_reliability(left, curves, right="within 10 degrees")
    left.set(xlabel="probability", ylabel="share of poses within 10 degrees")
    for number, (name, own) in enumerate(found.items()):
        right = np.array([one.record.right for one in own])
        probability = np.array([one.probability for one in own])
        order = np.argsort(-probability, kind="stable")
        true = np.cumsum(right[order])
        total = max(int(right.sum()), 1)
        colour = f"C{number}"
        other.plot(true / total, true / np.arange(1, len(own) + 1), color=colour, label=name)
        gates = np.array([one.by_gates for one in own])
        if gates.any():
            hits = int((gates & right).sum())
            other.plot(hits / total, hits / gates.sum(), "o", color=colour, label=f"{name}, gates")
    other.set(xlabel="recall of right poses", ylabel="precision", xlim=(0, 1.02), ylim=(0.5, 1.01))
    other.grid(alpha=0.3)
    other.legend(loc="lower left", fontsize=9)
    return figure


def _expected(evidence: Evidence, model: ProbabilityModel, part: str) -> float:
    own = getattr(evidence, f"jackknife_{part}_90_deg")
    if own is None:
        return math.nan
    factors = {"rotation": model.rotation_error, "translation": model.translation_error}
    return min(own * factors[part].factor(own), 180.0)


def _groups(found: Sequence[Judged]) -> dict[str, list[Judged]]:
    groups: dict[str, list[Judged]] = {}
    for one in found:
        groups.setdefault(one.record.source, []).append(one)
    return {**groups, "all": list(found)}


def _evidence(one: Judged) -> Evidence:
    assert one.record.evidence is not None
    return one.record.evidence
