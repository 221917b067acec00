"""Whether success can be trusted, and the error that a pose expects of itself.

Unrelated pairs must get no pose, true ones must get one. The pairs fall into two halves by a hash
of their names: gates are chosen on one half, and reported on the other.
"""

import hashlib
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from dgc_pose.benchmarks.scores import POSE_COLUMNS, RESULTS, SECONDS, PoseScore
from dgc_pose.benchmarks.table import aligned
from dgc_pose.errors import InputError
from dgc_pose.estimation import VerdictOptions
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.verdict import judge

PairKind = Literal["unrelated", "true", "rotation only"]

FAR_OFF_DEG = 10.0  # a pose with a larger error in R or t is wrong
FALSE_TARGET, MISSED_TARGET = 0.01, 0.05  # of unrelated pairs called a success, of true ones missed
_MIN_INLIERS = (15, 30, 60, 100)
_MIN_RATIOS = (0.15, 0.25, 0.35, 0.5)
_MIN_CELLS = (20, 1, 10, 15, 17, 25, 30, 35)


@dataclass(frozen=True)
class VerdictScore(PoseScore):
    """A row of bench-verdicts, with the evidence, so that other gates can be tried on it.

    Errors are NaN for unrelated images, and that of t for a camera that only rotated.
    """

    name: str
    group: str
    kind: PairKind
    rotation_90_deg: float  # what the pose expects of its error; NaN if it does not say
    translation_90_deg: float
    evidence_json: str  # empty if there were too few matches, or no model

    identity = ("method", "name")
    tables = {
        RESULTS: (
            *("method", "name", "group", "kind", "true_rotation_deg"),
            *POSE_COLUMNS,
            *("rotation_90_deg", "translation_90_deg", "evidence_json"),
            *SECONDS,
        )
    }

    @cached_property
    def evidence(self) -> Evidence | None:
        """What the verdict rests on."""
        if not self.evidence_json:
            return None
        values: dict[str, Any] = json.loads(self.evidence_json)
        return Evidence(**(values | {"rotation": np.array(values["rotation"])}))

    @property
    def chooses(self) -> bool:
        """Whether the pair is of the half that gates are chosen on."""
        return hashlib.sha256(self.name.encode()).digest()[0] % 2 == 0

    @property
    def far_off(self) -> bool:
        """Whether there is a pose, and a wrong one."""
        worse = max(self.rotation_error_deg, self.translation_error_deg)
        return self.success and worse > FAR_OFF_DEG


def succeeds(score: VerdictScore, gates: VerdictOptions) -> bool:
    """Whether the pair would be a success with these gates."""
    return score.evidence is not None and STATUSES[judge(score.evidence, gates).status].has_t


def rates(scores: Sequence[VerdictScore], gates: VerdictOptions) -> tuple[float, float]:
    """The shares of unrelated pairs called a success, and of true ones called a failure; NaN
    without such pairs."""
    false = [succeeds(score, gates) for score in scores if score.kind == "unrelated"]
    missed = [not succeeds(score, gates) for score in scores if score.kind == "true"]
    return float(np.mean(false or np.nan)), float(np.mean(missed or np.nan))


def choose_gates(scores: Sequence[VerdictScore]) -> VerdictOptions:
    """The gates with the smallest sum of both rates, each over its target; of equals the first,
    and the defaults before all others.

    Raises InputError without unrelated or without true pairs to choose on.
    """
    if not {"unrelated", "true"} <= {score.kind for score in scores}:
        raise InputError("gates need unrelated and true pairs to be chosen on; take more pairs")

    def loss(gates: VerdictOptions) -> float:
        false, missed = rates(scores, gates)
        return false / FALSE_TARGET + missed / MISSED_TARGET

    candidates = (
        VerdictOptions(min_inliers=inliers, min_inlier_ratio=ratio, min_occupied_cells=cells)
        for inliers, ratio, cells in itertools.product(_MIN_INLIERS, _MIN_RATIOS, _MIN_CELLS)
    )
    return min((VerdictOptions(), *candidates), key=loss)


def groups_table(scores: Sequence[VerdictScore]) -> str:
    """A row a group: what was called what, and whether 90 % means 90 %."""
    headings = ("pairs", "number", "a pose", "wrong", "no pose", "R med", "t med")
    table: list[tuple[str, ...]] = [(*headings, "R in 90 %", "t in 90 %", "statuses")]
    for group in dict.fromkeys(score.group for score in scores):
        rows = [score for score in scores if score.group == group]
        kind = rows[0].kind
        poses = sum(row.success for row in rows)
        rotation = _median([row.rotation_error_deg for row in rows])
        translation = _median([row.translation_error_deg for row in rows])
        statuses = [row.status for row in rows]
        table.append(
            (
                *(group, str(len(rows)), str(poses)),
                str(sum(row.far_off for row in rows)) if kind == "true" else "-",
                str(len(rows) - poses),
                "-" if kind == "unrelated" else rotation,
                translation if kind == "true" else "-",
                *coverage(rows),
                ", ".join(f"{name} {statuses.count(name)}" for name in sorted(set(statuses))),
            )
        )
    return aligned(table)


def coverage(scores: Sequence[VerdictScore]) -> tuple[str, str]:
    """How often the errors of R and of t are within what the pose expected, "k of n"."""
    true = [s for s in scores if s.kind == "true" and np.isfinite(s.rotation_90_deg)]
    if not true:
        return "-", "-"
    R = sum(score.rotation_error_deg <= score.rotation_90_deg for score in true)
    t = sum(score.translation_error_deg <= score.translation_90_deg for score in true)
    return f"{R} of {len(true)}", f"{t} of {len(true)}"


def gates_table(scores: Sequence[VerdictScore]) -> str:
    """The default gates and those chosen on one half, on both halves."""
    halves = {
        "choosing": [score for score in scores if score.chooses],
        "reporting": [score for score in scores if not score.chooses],
    }
    try:
        chosen = choose_gates(halves["choosing"])
    except InputError as error:  # no reason to lose the other table
        return f"no gates: {error}"
    rows = [("gates", "half", "unrelated", "a pose", "share", "true", "missed", "share")]
    for name, gates in (("default", VerdictOptions()), ("chosen", chosen)):
        for half, members in halves.items():
            kinds: list[str] = [score.kind for score in members]
            unrelated, true = (
                (str(kinds.count(kind)), f"{rate * kinds.count(kind):.0f}", f"{100 * rate:.1f} %")
                for kind, rate in zip(("unrelated", "true"), rates(members, gates), strict=True)
            )
            rows.append((name, half, *unrelated, *true))
    return (
        f"{aligned(rows)}\nchosen: min_inliers {chosen.min_inliers}, min_inlier_ratio "
        f"{chosen.min_inlier_ratio:g}, min_occupied_cells {chosen.min_occupied_cells}"
    )


def _median(errors: Sequence[float]) -> str:
    return f"{np.median(errors):.2f}"
