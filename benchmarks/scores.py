"""The record of what one method made of one pair: a row of results.csv, whose columns are its
fields."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PairScore:
    """Errors are infinite without a pose; NaN is what a method does not say.

    D_e is the symmetric epipolar distance to the true epipolar lines, in pixels of the images that
    the methods see: over all cells of the dense map (NaN without one), and over the matches that
    the pose was estimated from (infinite without any).
    """

    method: str
    image1: str  # as the list names it
    image2: str
    true_rotation_deg: float
    status: str
    success: bool
    num_matches: int
    num_inliers: int
    inlier_ratio: float
    rotation_error_deg: float
    translation_error_deg: float  # 0 to 180
    translation_folded_deg: float  # min(e, 180 - e)
    match_seconds: float  # wall clock of the steps that changed the matches
    estimate_seconds: float  # wall clock of all estimations
    rotation_90_deg: float  # what the pose expects of its error; NaN if it has none
    translation_90_deg: float
    probability: float  # that R and t are both within 10 degrees
    focal1_error: float  # ln of the focal length of the pose over the true one; NaN without a pose
    focal2_error: float
    focal1_std: float  # what the pose expects of it; 0 if K was exact for it
    focal2_std: float
    focal_ratio: float  # f that the matches suggest over that of K; NaN if they suggest none
    focal_ratio_std: float  # of its logarithm
    doubts_camera: bool  # whether by the pose a K may be wrong
    epipolar_all_px: float  # medians
    epipolar_confident_px: float
    epipolar_all_mean_px: float
    epipolar_confident_mean_px: float
