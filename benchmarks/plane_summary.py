"""The figures of a method on planes whose homographies have two poses, by the planes' relief."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dgc_pose.benchmarks.scores import PlaneScore
from dgc_pose.estimation.probability import RIGHT_DEG
from dgc_pose.files.tables import decimals

PLANE_HEADING = (
    "planes by relief, its height in widths of the view; poses claimed, and wrong ones among them "
    "(over 10 degrees in R or t);\n"
    "ambiguous: two poses, neither claimed; p, right: mean probability of the claimed poses and "
    "share of right ones, percent"
)
PLANE_COLUMNS = {
    "method": "{0.method}",
    "relief": "{0.relief_text}",
    "pairs": "{0.pairs}",
    "claimed": "{0.claimed}",
    "wrong": "{0.wrong}",
    "ambiguous": "{0.ambiguous}",
    "p": "{0.texts[probability_percent]}",
    "right": "{0.texts[right_percent]}",
}


@dataclass(frozen=True)
class PlaneSummary:
    """One method over the planes of one relief, or over all."""

    method: str
    relief: float | None  # its height, in widths of the plane that view 1 sees; None: all
    pairs: int
    claimed: int  # poses
    wrong: int  # of them, over 10 degrees off in R or t (0 to 180)
    ambiguous: int  # pairs with several poses, none of them claimed
    probability_percent: float  # mean, of the claimed poses; NaN without any
    right_percent: float  # of the claimed poses; NaN without any

    @property
    def relief_text(self) -> str:
        return "all" if self.relief is None else f"{100 * self.relief:g} %"

    @property
    def texts(self) -> dict[str, str]:
        """The shares of `PLANE_COLUMNS`."""
        names = ("probability_percent", "right_percent")
        return {name: decimals(getattr(self, name), 1) for name in names}


def summarise_planes(scores: Sequence[PlaneScore]) -> list[PlaneSummary]:
    """The figures of one method for each relief, in rising order, and for all."""
    reliefs = sorted({score.relief for score in scores})
    groups = [(relief, [s for s in scores if s.relief == relief]) for relief in reliefs]
    return [_summary(relief, group) for relief, group in (*groups, (None, scores))]


def _summary(relief: float | None, scores: Sequence[PlaneScore]) -> PlaneSummary:
    claimed = [score for score in scores if score.success]
    errors = np.array([max(s.rotation_error_deg, s.translation_error_deg) for s in claimed])
    right = int((errors <= RIGHT_DEG).sum())
    probability = [score.probability for score in claimed]
    return PlaneSummary(
        method=scores[0].method,
        relief=relief,
        pairs=len(scores),
        claimed=len(claimed),
        wrong=len(claimed) - right,
        ambiguous=sum(score.status == "ambiguous" for score in scores),
        probability_percent=100 * float(np.mean(probability)) if claimed else np.nan,
        right_percent=100 * right / len(claimed) if claimed else np.nan,
    )
