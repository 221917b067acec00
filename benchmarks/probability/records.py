"""Records of planned pairs: evidence and errors of each pair, whatever the verdict.

Each method matches a pair; its pose is estimated with K and with K withheld. A run of `open_run`
has one line for the records of each pair, and resumes after a kill.
"""

import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.benchmarks.probability.planned import PlanEntry, PlannedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.lines import calibrated, focal_scores
from dgc_pose.cameras.prior import auto_camera, by_lines
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.candidates import candidates
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import RIGHT_DEG
from dgc_pose.estimation.problem import MIN_MATCHES, TwoViewProblem
from dgc_pose.estimation.relative_pose import gathered, uncertainty
from dgc_pose.images.decoding import Header
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.pose import solve_pair

CameraCase = Literal["exact", "auto"]
_THOROUGH = EstimationOptions(effort="thorough", second="none")  # whatever is installed
_SAME_FOCAL = 0.05  # difference of ln f below which one camera may have taken both images
# Principal points farther from the middle, over the longer side, belong to synthetic cameras. The
# error of a focal length is not measured on them.
_USUAL_CENTRE = 0.015
_EQUAL_FOCAL = 1e-4  # largest difference of ln f between two K of one camera


@dataclass(frozen=True, eq=False)
class PoseRecord:
    """One of several poses that explain the matches."""

    likelihood: float  # see `Hypothesis`
    map_agreement: float | None
    rotation_error_deg: float  # infinite if the images show two scenes, or without a pose
    translation_error_deg: float

    @property
    def right(self) -> bool:
        """Whether R and t are both within 10 degrees."""
        return max(self.rotation_error_deg, self.translation_error_deg) <= RIGHT_DEG


@dataclass(frozen=True, eq=False)
class Record:
    """The evidence of a pair, and the errors of its poses."""

    entry: PlanEntry
    scene: str
    evidence: Evidence | None  # None without a model
    poses: tuple[PoseRecord, ...] = ()  # all that explain the matches about as well, best first
    cameras: CameraCase = "exact"
    # Error of ln f of the less certain camera, per cent; NaN if f was not fitted, or without a pose
    focal_error_percent: float = math.nan
    # Whether the true K are exact enough to measure errors of focal length. They are not if the
    # camera is synthetic, or if the K of one camera differ a little: then they are estimates.
    exact_cameras: bool = True

    @property
    def best(self) -> PoseRecord:
        return self.poses[0] if self.poses else PoseRecord(-math.inf, None, math.inf, math.inf)

    @property
    def exact(self) -> bool:
        """Whether the true pose is exact, see `PlanEntry.rough`, and K too."""
        return self.scene not in self.entry.rough and self.entry.kind != "wrong_k"

    @property
    def any_right(self) -> bool:
        """Whether any of the poses is right."""
        return any(pose.right for pose in self.poses)


def collect(
    pair: PlannedPair, matchers: Mapping[str, Matcher], options: EstimationOptions
) -> dict[str, Any]:
    """Match a pair with each method; return its records and the data for `fit_lines`, as JSON.

    Raises the errors of `pair.make`.
    """
    posed = pair.make()
    entry = pair.entry
    images = posed.image1, posed.image2
    camera1 = replace(posed.camera1, size=posed.image1.size)
    camera2 = replace(posed.camera2, size=posed.image2.size)
    posed = replace(posed, camera1=camera1, camera2=camera2)
    cameras = (camera1, camera2)
    scores = [focal_scores(image) for image in images]
    withheld = _withheld(pair, cameras, scores)
    results: dict[str, list[Any]] = {}
    for name, matcher in matchers.items():
        found = matcher.match(*images)
        matches = found.matches
        if matcher.engine is not None:
            pooled = solve_pair(*images, cameras, matcher, _THOROUGH).matches
            if not np.array_equal(pooled.points1, matches.points1):
                matches = pooled  # the pose was in doubt: these include matches searched again
        on_map = found.map_matches
        results[name] = [record(posed, "exact", matches, cameras, on_map, options)]
        if entry.withheld and pair.turn % entry.withheld == 0:
            results[name].append(record(posed, "auto", found.matches, withheld, on_map, options))
    focals = []
    if entry.part == "fit" and entry.kind == "list":
        for camera, (score, count) in zip(cameras, scores, strict=True):
            assert camera.size is not None
            true = float(np.log(camera.focal / max(camera.size)))
            focals.append((true, score.tolist(), count))
    return {
        "entry": entry.name,
        "number": pair.number,
        "scene": pair.scene,
        "records": results,
        "focals": focals,
    }


def record(
    posed: PosedPair,
    case: CameraCase,
    matches: Matches,
    stated: tuple[Camera, Camera],
    map_matches: Matches | None,
    options: EstimationOptions,
) -> dict[str, Any]:
    """The fields of a pair's `Record` as JSON, without entry and scene. stated: the cameras for the
    estimation."""
    data: dict[str, Any] = {
        "evidence": None,
        "poses": [],
        "cameras": case,
        "focal_error_percent": math.nan,
        "exact_cameras": _exact(posed),
    }
    problem = TwoViewProblem.of(matches, *stated, options)
    found = candidates(problem, map_matches) if len(problem) >= MIN_MATCHES else None
    if found is None:
        return data
    known = uncertainty(found)
    data["evidence"] = {
        name: value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        for name, value in vars(gathered(found, known)).items()
    }
    for choice in found.hypotheses:
        if choice.likely:
            rotation = translation = math.inf
            if posed.R is not None and posed.t is not None:
                rotation = rotation_error_deg(choice.R, posed.R)
                translation = translation_error_deg(choice.t, posed.t)
            pose = choice.likelihood, choice.map_agreement, rotation, translation
            data["poses"].append(pose)
    fitted = zip(known.cameras, (posed.camera1, posed.camera2), strict=True)
    if pairs := [(camera, true) for camera, true in fitted if camera.focal_std]:
        camera, true = max(pairs, key=lambda item: item[0].focal_std)
        data["focal_error_percent"] = 100 * abs(math.log(camera.focal / true.focal))
    return data


def records(
    pieces: Iterable[Mapping[str, Any]], method: str, entries: Sequence[PlanEntry]
) -> list[Record]:
    """The records of a method and of these entries, from the results of `collect`. Pieces of runs
    that are joined may lack a method."""
    by_name = {entry.name: entry for entry in entries}
    rows = []
    for piece in pieces:
        for fields in piece["records"].get(method, ()):
            evidence = fields["evidence"]
            if evidence is not None:
                evidence = Evidence(**{**evidence, "rotation": np.array(evidence["rotation"])})
            poses = tuple(PoseRecord(*pose) for pose in fields["poses"])
            known = {**fields, "evidence": evidence, "poses": poses}
            rows.append(Record(by_name[piece["entry"]], piece["scene"], **known))
    return rows


def _withheld(
    pair: PlannedPair, true: tuple[Camera, Camera], scores: Sequence[tuple[np.ndarray, int]]
) -> tuple[Camera, Camera]:
    """The cameras assumed if K is withheld. Half of the pairs that one camera may have taken are
    stated to be from one camera."""
    camera1, camera2 = true
    assert camera1.size is not None and camera2.size is not None
    alike = abs(math.log(camera1.focal / camera2.focal)) < _SAME_FOCAL
    # A hash of the name chooses the half: it does not depend on the other pairs
    name = f"{pair.entry.name} {pair.number:04d}"
    identity = "both" if alike and zlib.crc32(f"2 {name}".encode()) % 2 == 0 else None
    assumed = [
        replace(auto_camera(Header("", size)), identity=identity)
        for size in (camera1.size, camera2.size)
    ]
    first, second = by_lines(assumed, [calibrated(*found) for found in scores])
    return first, second


def _exact(posed: PosedPair) -> bool:
    difference = abs(math.log(posed.camera1.focal / posed.camera2.focal))
    if _EQUAL_FOCAL < difference < _SAME_FOCAL:
        return False
    for camera in (posed.camera1, posed.camera2):
        size = np.array(camera.size)
        if np.abs(camera.K[:2, 2] - (size - 1) / 2).max() / size.max() >= _USUAL_CENTRE:
            return False
    return True
