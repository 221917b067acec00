"""What the benchmark knows of one method on one pair: a row of results.csv and one of timings.csv.

Times differ from run to run and all else does not, so they have a file of their own: results.csv is
the same to the byte for any number of workers and after any number of kills.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Protocol = Literal["paper", "native"]


@dataclass(frozen=True)
class DtuResult:
    """What one method made of one pair; the fields are the columns of results.csv."""

    method: str
    scene: int
    view1: int
    view2: int
    image1: str  # relative to the data set's root
    image2: str
    protocol: Protocol
    true_rotation_deg: float
    true_baseline_mm: float
    overlap: float  # share of space at the object that both views see, 0 to 1
    status: str
    success: bool
    num_matches: int
    num_inliers: int
    inlier_ratio: float
    rotation_error_deg: float  # infinite without a pose, as are the next two
    translation_error_deg: float  # 0 to 180
    translation_folded_deg: float  # min(e, 180 - e)
    # D_e, the symmetric epipolar distance to the true epipolar lines, in pixels of the protocol's
    # images, over all pixels of image 2 (NaN for a method that matches only some) and over the
    # matches that the method trusts (infinite where there are none)
    epipolar_all_px: float  # medians
    epipolar_confident_px: float
    epipolar_all_mean_px: float
    epipolar_confident_mean_px: float

    @property
    def key(self) -> tuple[str, int, int, int]:
        """method, scene, view1, view2."""
        return self.method, self.scene, self.view1, self.view2


@dataclass(frozen=True)
class DtuTiming:
    """The times of one method on one pair; the fields are the columns of timings.csv."""

    method: str
    scene: int
    view1: int
    view2: int
    match_seconds: float  # with the encoder's passes that fell to this pair
    pose_seconds: float  # of the processor, so that other processes do not count

    @property
    def key(self) -> tuple[str, int, int, int]:
        """method, scene, view1, view2."""
        return self.method, self.scene, self.view1, self.view2
