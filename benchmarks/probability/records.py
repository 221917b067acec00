"""From stored matches to evidence and errors: records of each pair, whatever the verdict.

A pair is estimated with its K, and with K withheld.
"""

import math
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Literal

import numpy as np

from dgc_pose.benchmarks.posed_pairs import Truth
from dgc_pose.benchmarks.probability.collection import StoredPair
from dgc_pose.benchmarks.probability.plan import PlanEntry
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.lines import calibrated
from dgc_pose.cameras.prior import auto_camera, by_lines
from dgc_pose.estimation import EstimationOptions, Hypothesis
from dgc_pose.estimation.candidates import candidates
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import RIGHT_DEG
from dgc_pose.estimation.problem import MIN_MATCHES, TwoViewProblem
from dgc_pose.estimation.relative_pose import gathered, uncertainty
from dgc_pose.images.header import Header
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.system.threads import in_threads

_CHUNK = 16
CameraCase = Literal["exact", "auto"]
_SAME_FOCAL = 0.05  # difference of ln f below which one camera may have taken both images
# Principal points farther from the middle, over the longer side, are of no photograph: of drawn
# cameras. They show nothing of what the deviation of a focal length is worth.
_USUAL_CENTRE = 0.015
_EQUAL_FOCAL = 1e-4  # difference of ln f of the K of one camera


@dataclass(frozen=True, eq=False)
class PoseRecord:
    """One of several poses that explain the matches."""

    likelihood: float  # see `Hypothesis`
    map_agreement: float | None
    rotation_error_deg: float  # infinite if the images are of two scenes, and without a pose
    translation_error_deg: float

    @property
    def right(self) -> bool:
        """Whether R and t are both within 10 degrees."""
        return max(self.rotation_error_deg, self.translation_error_deg) <= RIGHT_DEG


@dataclass(frozen=True, eq=False)
class Record:
    """What a pair's evidence is, and how wrong its pose."""

    entry: PlanEntry
    scene: str
    evidence: Evidence | None  # None without a model
    poses: tuple[PoseRecord, ...] = ()  # all that explain the matches about as well, the best first
    cameras: CameraCase = "exact"
    # Of ln f of the less certain camera, per cent; NaN if it was not fitted, and without a pose.
    focal_error_percent: float = math.nan
    # Whether the true K say what an error of a focal length is: not if they are of no photograph,
    # and not if they differ a little between images of one camera, since they are estimates then.
    exact_cameras: bool = True

    @property
    def best(self) -> PoseRecord:
        return self.poses[0] if self.poses else PoseRecord(-math.inf, None, math.inf, math.inf)

    @property
    def exact(self) -> bool:
        """Whether the true pose is: see `PlanEntry.rough`."""
        return self.scene not in self.entry.rough

    @property
    def any_right(self) -> bool:
        """Whether the pose or another that explains the matches about as well is right."""
        return any(pose.right for pose in self.poses)


def records(pairs: Iterable[StoredPair], options: EstimationOptions) -> Iterator[Record]:
    """The records of each pair, in order."""
    stored = iter(pairs)
    while chunk := list(islice(stored, _CHUNK)):
        work: list[tuple[StoredPair, CameraCase]] = [(pair, "exact") for pair in chunk]
        work += [(p, "auto") for p in chunk if p.entry.withheld and not p.matches.key_points]
        yield from in_threads(lambda item: record(item[0], options, item[1]), work)


def record(pair: StoredPair, options: EstimationOptions, cameras: CameraCase = "exact") -> Record:
    """The record of one pair."""
    truth = pair.truth
    stated = _cameras(pair, cameras)
    matches = pair.matches if pair.pooled is None or cameras != "exact" else pair.pooled
    problem = TwoViewProblem.of(matches, *stated, options)
    poses: tuple[PoseRecord, ...] = ()
    found, evidence, focal_error = None, None, math.nan
    if len(problem) >= MIN_MATCHES:
        found = candidates(problem, pair.map_matches)
    if found is not None:
        known = uncertainty(found)
        evidence, focal_error = gathered(found, known), _focal_error(known.cameras, truth)
        poses = tuple(_pose_record(choice, truth) for choice in found.hypotheses if choice.likely)
    facts = cameras, focal_error, _exact(truth)
    return Record(pair.entry, pair.scene, evidence, poses, *facts)


def _pose_record(choice: Hypothesis, truth: Truth) -> PoseRecord:
    rotation = translation = math.inf
    if truth.R is not None and truth.t is not None:
        rotation = rotation_error_deg(choice.R, truth.R)
        translation = translation_error_deg(choice.t, truth.t)
    return PoseRecord(choice.likelihood, choice.map_agreement, rotation, translation)


def _cameras(pair: StoredPair, case: CameraCase) -> tuple[Camera, Camera]:
    """The cameras that the estimation gets. Withheld, those of half of the pairs that one camera
    may have taken are stated to be one."""
    camera1, camera2 = pair.truth.camera1, pair.truth.camera2
    if case == "exact":
        return camera1, camera2
    assert camera1.size is not None and camera2.size is not None
    alike = abs(math.log(camera1.focal / camera2.focal)) < _SAME_FOCAL
    # The same half whatever else is estimated
    alike = alike or pair.entry.kind == "zoomed"  # as their sizes say
    identity = "both" if alike and zlib.crc32(f"2 {pair.name}".encode()) % 2 == 0 else None
    assumed = [
        replace(auto_camera(Header("", size)), identity=identity)
        for size in (camera1.size, camera2.size)
    ]
    first, second = by_lines(assumed, [calibrated(*scores) for scores in pair.scores])
    return first, second


def _focal_error(cameras: tuple[Camera, Camera], truth: Truth) -> float:
    fitted = zip(cameras, (truth.camera1, truth.camera2), strict=True)
    pairs = [(camera, true) for camera, true in fitted if camera.focal_std]
    if not pairs:
        return math.nan
    camera, true = max(pairs, key=lambda item: item[0].focal_std)
    return 100 * abs(math.log(camera.focal / true.focal))


def _exact(truth: Truth) -> bool:
    difference = abs(math.log(truth.camera1.focal / truth.camera2.focal))
    if _EQUAL_FOCAL < difference < _SAME_FOCAL:
        return False
    for camera in (truth.camera1, truth.camera2):
        size = np.array(camera.size)
        if np.abs(camera.K[:2, 2] - (size - 1) / 2).max() / size.max() >= _USUAL_CENTRE:
            return False
    return True
