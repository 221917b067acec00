"""Statuses of a result and their meaning, and texts for the numbers of a result."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

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
    "same_picture",
    "panorama",
]


@dataclass(frozen=True)
class StatusFacts:
    """The meaning of a status."""

    meaning: str  # one sentence for people
    has_t: bool = False  # a success: R and t are known
    colmap: str | None = None  # COLMAP's configuration of the pair; None: no two-view geometry
    shows_cameras: bool = False  # the matches are evidence of K


STATUSES: Mapping[Status, StatusFacts] = {
    "ok": StatusFacts("a pose", True, "CALIBRATED", shows_cameras=True),
    "planar": StatusFacts("a pose from a nearly planar scene", True, "PLANAR", shows_cameras=True),
    "rotation_only": StatusFacts("the images do not determine t", False, "PANORAMIC"),
    "too_few_matches": StatusFacts("fewer than 20 distinct matches"),
    "no_model": StatusFacts("RANSAC finds no essential matrix"),
    "chance_inliers": StatusFacts("no more inliers than unrelated images would have"),
    "collinear": StatusFacts("the inliers lie on one line, and many poses fit a line"),
    "behind_cameras": StatusFacts("many points would lie behind a camera"),
    "undetermined": StatusFacts("the inliers do not determine the rotation", shows_cameras=True),
    "improbable": StatusFacts(
        "all evidence together makes the pose improbable", shows_cameras=True
    ),
    "ambiguous": StatusFacts("two or more poses explain the matches"),
    "mirrored": StatusFacts("the mirror image of image 2 agrees with image 1 far better"),
    "same_picture": StatusFacts("the images are one picture, or share an overlay"),
    "panorama": StatusFacts("an image is a panorama"),
}
CONFIGURATIONS: Mapping[str, str] = {  # COLMAP's, if there is one
    status: facts.colmap for status, facts in STATUSES.items() if facts.colmap is not None
}


def percent_text(probability: float) -> str:
    """A probability for people: never 0 or 100 %, which no evidence gives."""
    if probability > 0.995:
        return "over 99 %"
    return "below 1 %" if probability < 0.005 else f"{100 * probability:.0f} %"


def probability_text(probability: float | None, of: str = "") -> str:
    """A probability as text; None: not known. of: the object or event that it belongs to."""
    if probability is None:
        return "probability not known" + (" for such matches" if of else "")
    return f"probability {percent_text(probability)} {of}".rstrip()


def short_text(array: np.ndarray) -> str:
    """A small array in one line, with four decimals."""
    text = np.array2string(array, formatter={"float_kind": lambda v: f"{round(v, 4) + 0.0:.4f}"})
    return " ".join(text.split())
