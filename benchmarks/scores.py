"""Records: what one method made of one pair. The columns of the result tables are their fields."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, TypeVar

RESULTS, TIMINGS = "results.csv", "timings.csv"
_PAIR = ("method", "image1", "image2")
_VIEWS = ("method", "scene", "view1", "view2")


@dataclass(frozen=True)
class PoseScore:
    """What every data set records. Errors are infinite without a pose."""

    method: str
    true_rotation_deg: float
    status: str
    success: bool
    num_matches: int
    num_inliers: int
    inlier_ratio: float
    rotation_error_deg: float
    translation_error_deg: float  # 0 to 180
    translation_folded_deg: float  # min(e, 180 - e)
    # Wall clock of the steps to the matches, each when it was done for the first time; of a pose in
    # doubt also its first estimation and its search.
    match_seconds: float
    estimate_seconds: float  # CPU time, which other processes do not add to

    tables: ClassVar[Mapping[str, Sequence[str]]] = {}  # by file, the fields that are its columns
    headings: ClassVar[Mapping[str, str]] = {}  # of columns that are not called as their field
    decimals: ClassVar[int | None] = None  # that numbers are rounded to


Score = TypeVar("Score", bound=PoseScore)

POSE_COLUMNS = (
    *("status", "success", "num_matches", "num_inliers", "inlier_ratio"),
    *("rotation_error_deg", "translation_error_deg", "translation_folded_deg"),
)
SECONDS = ("match_seconds", "estimate_seconds")
_EPIPOLAR = (
    *("epipolar_all_px", "epipolar_confident_px"),
    *("epipolar_all_mean_px", "epipolar_confident_mean_px"),
)

_CAMERA = (
    *("rotation_90_deg", "translation_90_deg", "probability"),
    *("focal1_error", "focal2_error", "focal1_std", "focal2_std"),
    *("focal_ratio", "focal_ratio_std", "doubts_camera"),
)


@dataclass(frozen=True)
class PairScore(PoseScore):
    """A row of bench-pairs."""

    image1: str  # as the list names it
    image2: str

    tables = {RESULTS: (*_PAIR, "true_rotation_deg", *POSE_COLUMNS, *SECONDS)}


@dataclass(frozen=True)
class CameraScore(PairScore):
    """A row of bench-pairs whose cameras are withheld or changed."""

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

    tables = {RESULTS: (*PairScore.tables[RESULTS], *_CAMERA)}


@dataclass(frozen=True)
class MapScore(PairScore):
    """A row of bench-pairs on rendered pairs.

    D_e is the symmetric epipolar distance to the true epipolar lines, in pixels of the images that
    the methods see: over all pixels of image 2 (NaN without a dense map), and over the matches that
    the pose was estimated from (infinite without any).
    """

    epipolar_all_px: float  # medians
    epipolar_confident_px: float
    epipolar_all_mean_px: float
    epipolar_confident_mean_px: float

    tables = {RESULTS: (*PairScore.tables[RESULTS], *_EPIPOLAR)}


@dataclass(frozen=True)
class DtuScore(MapScore):
    """A row of bench-dtu.

    The times have a table of their own: without them results.csv is the same to the byte for any
    number of workers and after any number of kills.
    """

    scene: int
    view1: int
    view2: int
    protocol: str
    true_baseline_mm: float
    overlap: float  # share of space at the object that both views see, 0 to 1

    headings = {"estimate_seconds": "pose_seconds"}
    decimals = 4  # more would be rounding errors of one library or another
    tables = {
        RESULTS: (
            *_VIEWS,
            *("image1", "image2", "protocol", "true_rotation_deg", "true_baseline_mm", "overlap"),
            *POSE_COLUMNS,
            *_EPIPOLAR,
        ),
        TIMINGS: (*_VIEWS, *SECONDS),
    }


def make_score(kind: type[Score], values: Mapping[str, Any]) -> Score:
    """A record from all that is known, of which it takes its fields."""
    chosen = {field.name: values[field.name] for field in fields(kind)}
    if kind.decimals is not None:
        numbers = {name: float(v) for name, v in chosen.items() if isinstance(v, float)}
        chosen |= {name: round(number, kind.decimals) for name, number in numbers.items()}
    return kind(**chosen)
