"""Whether success can be trusted, and the error that a pose expects of itself.

Unrelated pairs must get no pose, true ones must get one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dgc_pose.benchmarks.scores import POSE_COLUMNS, RESULTS, SECONDS, PoseScore
from dgc_pose.files.tables import aligned

PairKind = Literal["unrelated", "true", "rotation only"]

FAR_OFF_DEG = 10.0  # a pose with a larger error in R or t is wrong


@dataclass(frozen=True)
class VerdictScore(PoseScore):
    """A row of bench-verdicts.

    Errors are NaN for unrelated images, and that of t for a camera that only rotated.
    """

    name: str
    group: str
    kind: PairKind
    rotation_90_deg: float  # what the pose expects of its error; NaN if it does not say
    translation_90_deg: float

    identity = ("method", "name")
    tables = {
        RESULTS: (
            *("method", "name", "group", "kind", "true_rotation_deg"),
            *POSE_COLUMNS,
            *("rotation_90_deg", "translation_90_deg"),
            *SECONDS,
        )
    }

    @property
    def far_off(self) -> bool:
        """Whether there is a pose, and a wrong one."""
        worse = max(self.rotation_error_deg, self.translation_error_deg)
        return self.success and worse > FAR_OFF_DEG


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


def _median(errors: Sequence[float]) -> str:
    return f"{np.median(errors):.2f}"
