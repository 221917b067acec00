"""A pair of a batch: its pose, also as a line of JSON, its matches, and their errors."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.camera_model import ModelName, model_named
from dgc_pose.geometry.epipolar import sampson_distance
from dgc_pose.matches import Matches
from dgc_pose.system.files import read_as

# Statuses of pairs without an estimate. BAD_INPUT: an image or camera is unusable. FAILED: matching
# or estimation raised an unexpected error; a resumed batch matches the pair again.
BAD_INPUT = "bad_input"
FAILED = "failed"
MIN_FOLDER_PROBABILITY = (
    0.6  # folder probability to accept a pose; `fit-folders` has fewest errors with it
)


@dataclass(frozen=True, eq=False)
class PairRow:
    """The pose of one pair, cam2_from_cam1: x2 = R x1 + t, with t up to scale."""

    name1: str
    name2: str
    status: str  # of the pose, or "bad_input" or "failed"
    reason: str  # one sentence for people
    # Without `evidence` and `hypotheses`. If read from JSON, `inliers` has only their number.
    pose: RelativePose | None = None  # None without an estimate
    error_px: float | None = None  # expected error of a match, pixels of the originals
    camera_model: ModelName = "assumed"  # the model that the matches agree with
    bad_images: Mapping[str, str] = field(default_factory=dict)  # by name, why they are unusable
    index: int = 0  # of the pair in the batch
    second: bool = False  # whether the second matcher matched it too
    # Probability of the pose given the whole folder; None without a pose, and before the result
    folder_probability: float | None = None
    # Triples whose two other pairs are accepted: how many agree with it, and how many do not
    folder_triples: tuple[int, int] = (0, 0)

    @property
    def names(self) -> tuple[str, str]:
        return self.name1, self.name2

    @property
    def success(self) -> bool:
        return self.pose is not None and self.pose.success

    @property
    def num_matches(self) -> int:
        return 0 if self.pose is None else self.pose.num_matches

    @property
    def num_inliers(self) -> int:
        return 0 if self.pose is None else self.pose.num_inliers

    @property
    def probability(self) -> float | None:
        """Probability that R and t are both within 10 degrees; None if no model of it is fitted."""
        return None if self.pose is None else self.pose.probability

    @property
    def rejected(self) -> bool:
        """Whether the folder rejects the pose or rotation of the pair."""
        return (
            self.folder_probability is not None and self.folder_probability < MIN_FOLDER_PROBABILITY
        )

    @property
    def fitted_cameras(self) -> tuple[Camera, Camera] | None:
        """The cameras fitted to only this pair; None if none were fitted."""
        pose = self.pose
        if pose is None or pose.camera1 is None or pose.camera2 is None:
            return None
        return None if pose.camera_covariance is None else (pose.camera1, pose.camera2)

    def to_json(self) -> str:
        """A line of strict JSON: the names, and the values of `RelativePose.to_dict`.

        Times are omitted, so that the same input gives the same row.
        """
        names = {"name1": self.name1, "name2": self.name2, "second": self.second}
        if self.pose is None:
            facts = {"status": self.status, "success": False, "warnings": [self.reason]}
            return json.dumps({**names, **facts, "bad_images": dict(self.bad_images)})
        values = self.pose.to_dict() | {"error_px": self.error_px}
        del values["seconds"]
        values |= {"camera_model": self.camera_model, "folder_probability": self.folder_probability}
        values["folder_triples"] = self.folder_triples
        return json.dumps({**names, **values}, allow_nan=False)


def row_of(names: tuple[str, str], pose: RelativePose, error_px: float, index: int = 0) -> PairRow:
    """The row of an estimated pose."""
    model: ModelName = "assumed" if pose.evidence is None else pose.evidence.camera_model
    pose = replace(pose, evidence=None, hypotheses=())
    return PairRow(*names, pose.status, pose.reason, pose, error_px, model, index=index)


def parse_row(text: str, index: int, where: str) -> PairRow:
    """The row of a line of JSON. Raises InputError, with `where`, if the line is not a row."""
    with read_as("a row of a batch", where):
        data: Any = json.loads(text)
        names = (str(data["name1"]), str(data["name2"]))
        status = data["status"]
        second = bool(data.get("second", False))  # rows of earlier versions lack it
        if status in (BAD_INPUT, FAILED):
            reason = str(data["warnings"][0])
            bad = dict(data["bad_images"])
            return PairRow(*names, status, reason, bad_images=bad, index=index, second=second)
        try:
            pose = RelativePose.from_dict(data | {"seconds": {}})
        except InputError as error:
            raise ValueError(str(error)) from None
        model = model_named(data["camera_model"]).name
        probability = data["folder_probability"]
        agree, differ = data["folder_triples"]
        return PairRow(
            *(*names, status, pose.reason, pose, data["error_px"], model),
            index=index,
            second=second,
            folder_probability=None if probability is None else float(probability),
            folder_triples=(int(agree), int(differ)),
        )


_NO_POINTS = np.zeros((0, 2))
_NO_MATCHES = Matches(_NO_POINTS, _NO_POINTS, np.zeros(0), error_px=1.0)


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """A pair with its matches, pixels of the original images."""

    row: PairRow  # the inliers of its pose refer to `matches`
    matches: Matches = _NO_MATCHES
    # Even sample of the dense map; None without a map, and if the pose is not estimated again.
    map_matches: Matches | None = None


def epipolar_error_px(
    row: PairRow, cameras: Sequence[Camera], points1: np.ndarray, points2: np.ndarray
) -> np.ndarray:
    """Sampson distances (N,) of matches to the pose of a pair, pixels of the originals; infinite
    where distortion cannot be undone, and 0 without a translation. cameras: the pose's cameras."""
    if row.pose is None or row.pose.E is None:
        return np.zeros(len(points1))
    camera1, camera2 = cameras
    normalised = camera1.normalise(points1), camera2.normalise(points2)
    distance = sampson_distance(*normalised, row.pose.E) * (camera1.focal + camera2.focal) / 2
    return np.where(np.isfinite(distance), distance, np.inf)
