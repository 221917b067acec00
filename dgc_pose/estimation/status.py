"""The statuses of a result: what is known with each."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Status = Literal[
    "ok",
    "planar",
    "rotation_only",
    "too_few_matches",
    "no_model",
    "chance_inliers",
    "collinear",
    "behind_cameras",
    "undetermined",
    "improbable",
    "ambiguous",
    "mirrored",
]


@dataclass(frozen=True)
class StatusFacts:
    """The meaning of a status."""

    meaning: str  # one sentence for people
    has_R: bool = False
    has_t: bool = False  # a success: R and t are known
    colmap: str | None = None  # COLMAP's configuration of the pair; None: no two-view geometry

    @property
    def rotation_alone(self) -> bool:
        """Whether R is known and t is not."""
        return self.has_R and not self.has_t


STATUSES: Mapping[Status, StatusFacts] = {
    "ok": StatusFacts("a pose", True, True, "CALIBRATED"),
    "planar": StatusFacts("a pose from a nearly planar scene", True, True, "PLANAR"),
    "rotation_only": StatusFacts("the images do not determine t", True, False, "PANORAMIC"),
    "too_few_matches": StatusFacts("fewer than 20 distinct matches"),
    "no_model": StatusFacts("RANSAC has no essential matrix"),
    "chance_inliers": StatusFacts("no more inliers than unrelated images would have"),
    "collinear": StatusFacts("the inliers lie on one line, which many poses explain"),
    "behind_cameras": StatusFacts("many points would lie behind a camera"),
    "undetermined": StatusFacts("the inliers do not determine the rotation"),
    "improbable": StatusFacts("the evidence altogether speaks against the pose"),
    "ambiguous": StatusFacts(
        "two or more poses explain the matches, and which of them is right does not show"
    ),
    "mirrored": StatusFacts("the mirror image of image 2 has a pose, image 2 has none as likely"),
}
CONFIGURATIONS: Mapping[str, str] = {  # COLMAP's, of the pairs that have one
    status: facts.colmap for status, facts in STATUSES.items() if facts.colmap is not None
}
