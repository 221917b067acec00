"""What the server hands to its second worker; the server itself imports no network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dgc_pose.estimation import RelativePose
    from dgc_pose.matching import Matcher
    from dgc_pose.serve.estimator import Estimator


@dataclass(frozen=True)
class EstimatorFactory:
    """Makes the estimator in its worker; `Worker` takes it."""

    load: Callable[[], Matcher]
    describe: Callable[[RelativePose], dict[str, Any]]  # as the command writes JSON
    weights: str | None  # as the command takes them; None for the default

    def __call__(self) -> Estimator:
        from dgc_pose.serve.estimator import Estimator

        return Estimator(self.load(), self.describe, self.weights)
