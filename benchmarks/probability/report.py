"""What a probability is worth on scenes that nothing was fitted on."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.benchmarks.probability.records import Record
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.choice import choice_shares, utility
from dgc_pose.estimation.covariance import NORMAL_90
from dgc_pose.estimation.probability import ErrorModel, ProbabilityModel
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.verdict import judge
from dgc_pose.files.tables import aligned
from dgc_pose.metrics import Reliability, pose_auc

_ROTATIONS = (0, 15, 30, 45, 180)  # degrees, edges of bins
_INLIERS = (0, 60, 200, 600, math.inf)
_DEVIATIONS = (0, 1, 2, 5, 15, math.inf)  # per cent of a focal length
_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99)


@dataclass(frozen=True, eq=False)
class Judged:
    """A record with what is claimed of it."""

    record: Record
    by_probability: bool
    probability: float  # 0 if the evidence says that the translation is not determined
    rotation_90_deg: float
    translation_90_deg: float
    focal_90_percent: float = math.nan  # of a focal length that was fitted
    ambiguous: bool = False

    @property
    def right(self) -> bool:
        return self.record.right


def judged(record: Record, model: ProbabilityModel, focal_error: ErrorModel) -> Judged:
    """The verdict on a record, by the probability."""
    evidence = record.evidence
    if evidence is None:
        return Judged(record, False, 0.0, math.nan, math.nan)
    any_right = model.probability(evidence)
    shares = choice_shares([utility(pose, model.choice) for pose in record.poses])
    order = np.argsort(-shares, kind="stable")
    share, best = float(shares[order[0]]), record.poses[order[0]]
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
        0.0 if known.rotation_alone else share * any_right,
        min(_expected(evidence.jackknife_rotation_90_deg, model.rotation_error), 180.0),
        min(_expected(evidence.jackknife_translation_90_deg, model.translation_error), 180.0),
        _expected(evidence.jackknife_focal_90_percent, focal_error),
        verdict.status == "ambiguous",
    )


def report_text(poses: Sequence[Judged]) -> str:
    """All tables. Of poses with a wrong K the first alone."""
    wrong = [pose for pose in poses if pose.record.cameras == "wrong"]
    poses = [pose for pose in poses if pose.record.cameras != "wrong"]
    parts = [
        "Claimed and refused, by data set. A pose is right within 10 degrees in R and t.",
        claims_table(poses),
        "AUC@5/10/20 with the verdict, and with every pair answered (true pairs alone)",
        auc_table(poses),
        f"calibration error of the probability {100 * reliability(poses).calibration_error:.1f} %",
        reliability_table(poses),
        "precision and recall of right poses by the least probability",
        levels_table(poses),
        "share of right claimed poses whose error is within the expected one, 90 % of them meant; "
        "scenes of a rough reference left out",
        coverage_table(poses),
    ]
    if any(math.isfinite(pose.focal_90_percent) for pose in poses):
        parts += ["focal lengths that were fitted", focal_table(poses)]
    if wrong:
        bins = reliability(wrong)
        parts += [
            "The same pairs, a third of them, with focal lengths that are wrong by a factor of 0.5 "
            "to 2",
            claims_table(wrong),
            f"calibration error of the probability {100 * bins.calibration_error:.1f} %",
        ]
    return "\n\n".join(parts)


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


def auc_table(poses: Sequence[Judged]) -> str:
    """With the verdict, and without one."""
    rows: list[tuple[str, ...]] = [("pairs", "probability", "all answered")]
    for name, members in _groups(poses).items():
        errors = np.array([pose.record.pair_error_deg for pose in members])
        if not np.isfinite(errors).any():
            continue
        claims = (_values(members, "by_probability"), np.ones(len(members), bool))
        cells = (pose_auc(np.where(claim, errors, np.inf)) for claim in claims)
        rows.append((name, *("/".join(f"{a:.1f}" for a in auc) for auc in cells)))
    return aligned(rows)


def reliability(poses: Sequence[Judged]) -> Reliability:
    """Of the probability of the poses that have evidence."""
    known = [pose for pose in poses if pose.record.evidence is not None]
    return Reliability.of(_values(known, "probability"), _values(known, "right"))


def reliability_table(poses: Sequence[Judged]) -> str:
    """Of each tenth of probability the mean, and the share that is right."""
    bins = reliability(poses)
    rows = [("probability", "poses", "mean", "right")]
    columns = (bins.edges, bins.counts, bins.mean_confidence, bins.share_correct)
    for low, count, mean, right in zip(*columns, strict=False):
        if count:
            name = f"{low:.1f} to {low + 0.1:.1f}"
            rows.append((name, str(count), f"{100 * mean:.0f} %", f"{100 * right:.0f} %"))
    return aligned(rows)


def levels_table(poses: Sequence[Judged]) -> str:
    """Precision and recall at several least probabilities."""
    rows = [("least probability", "claimed", "precision", "recall")]
    right, probability = _values(poses, "right"), _values(poses, "probability")
    for level in _LEVELS:
        claimed = probability >= level
        true = int((claimed & right).sum())
        precision = f"{100 * true / claimed.sum():.1f} %" if claimed.any() else "-"
        rows.append(
            (f"{level:g}", str(claimed.sum()), precision, f"{100 * true / right.sum():.1f} %")
        )
    return aligned(rows)


def coverage_table(poses: Sequence[Judged]) -> str:
    """By bins of rotation and of inliers."""
    claimed = [p for p in poses if p.by_probability and p.right and p.record.exact]
    evidence = [pose.record.evidence for pose in claimed]
    angles = np.array([e.rotation_angle_deg for e in evidence if e is not None])
    inliers = np.array([e.num_inliers for e in evidence if e is not None])
    bins = {"all": np.ones(len(claimed), bool)}
    for low, high in zip(_ROTATIONS, _ROTATIONS[1:], strict=False):
        bins[f"rotation {low} to {high} deg"] = (low <= angles) & (angles < high)
    for less, more in zip(_INLIERS, _INLIERS[1:], strict=False):
        bins[f"inliers {less:.0f} to {more:.0f}"] = (less <= inliers) & (inliers < more)
    R = np.array([p.record.rotation_error_deg <= p.rotation_90_deg for p in claimed])
    t = np.array([p.record.translation_error_deg <= p.translation_90_deg for p in claimed])
    rows: list[tuple[str, ...]] = [("poses", "number", "R within", "t within")]
    for name, chosen in bins.items():
        if chosen.any():
            shares = (f"{100 * np.mean(within[chosen]):.0f} %" for within in (R, t))
            rows.append((name, str(chosen.sum()), *shares))
    return aligned(rows)


def focal_table(poses: Sequence[Judged]) -> str:
    """By what the fit says of them: errors of ln f, and how many are within two deviations."""
    rows = [("deviation of f", "poses", "median error", "within two deviations")]
    members = [p for p in poses if p.by_probability and math.isfinite(p.record.focal_error_percent)]
    error = np.array([pose.record.focal_error_percent for pose in members])
    std = np.array([pose.focal_90_percent for pose in members]) / NORMAL_90
    for low, high in zip(_DEVIATIONS, _DEVIATIONS[1:], strict=False):
        chosen = (low <= std) & (std < high)
        if chosen.any():
            within = 100 * np.mean(error[chosen] <= 2 * std[chosen])
            median = f"{np.median(error[chosen]):.2f} %"
            name = f"{low:g} to {high:g} %"
            rows.append((name, str(chosen.sum()), median, f"{within:.0f} %"))
    return aligned(rows)


def reliability_figure(kinds: Mapping[str, Sequence[Judged]]) -> Figure:
    """The reliability diagram and precision against recall, a curve a kind of matches."""
    from dgc_pose.benchmarks.curves import draw_reliability
    from dgc_pose.viz.figure import new_figure

    figure = new_figure(11, 5)
    left, other = figure.subplots(1, 2)
    curves = {name: reliability(poses) for name, poses in kinds.items()}
    draw_reliability(left, curves, right="within 10 degrees")
    left.set(xlabel="probability", ylabel="share of poses within 10 degrees")
    for number, (name, poses) in enumerate(kinds.items()):
        right = _values(poses, "right")
        order = np.argsort(-_values(poses, "probability"), kind="stable")
        true = np.cumsum(right[order])
        total = max(int(right.sum()), 1)
        other.plot(
            true / total, true / np.arange(1, len(poses) + 1), color=f"C{number}", label=name
        )
    other.set(xlabel="recall of right poses", ylabel="precision", xlim=(0, 1.02), ylim=(0.5, 1.01))
    other.grid(alpha=0.3)
    other.legend(loc="lower left", fontsize=9)
    return figure


def _values(poses: Sequence[Judged], name: str) -> np.ndarray:
    kind = float if name == "probability" else bool
    return np.array([getattr(pose, name) for pose in poses], kind)


def _expected(error: float | None, model: ErrorModel) -> float:
    return math.nan if error is None else error * model.factor(error)


def _groups(poses: Sequence[Judged]) -> dict[str, list[Judged]]:
    groups: dict[str, list[Judged]] = {}
    for pose in poses:
        groups.setdefault(pose.record.entry, []).append(pose)
    return {**groups, "all": list(poses)}
