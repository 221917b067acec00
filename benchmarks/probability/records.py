"""From stored matches to evidence and errors: a record for each pair, whatever the verdict."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

from dgc_pose.benchmarks.probability.collection import StoredPair
from dgc_pose.benchmarks.probability.plan import Part
from dgc_pose.estimation import EstimationOptions, VerdictOptions, estimate_pose
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import RIGHT_DEG
from dgc_pose.metrics import folded, rotation_error_deg, translation_error_deg
from dgc_pose.system.threads import in_threads

# Gates that every model passes, so that its pose is known.
ANY_POSE = VerdictOptions(
    min_probability=None,
    min_inliers=0,
    min_inlier_ratio=0.0,
    max_log10_false_alarms=math.inf,
    chance_factor=0.0,
    min_occupied_cells=0,
    min_cheirality=0.0,
    rotation_share=math.inf,
    strict_rotation_share=math.inf,
    max_rotation_error_deg=math.inf,
)
_CHUNK = 16


@dataclass(frozen=True, eq=False)
class Record:
    """What a pair's evidence is, and how wrong its pose."""

    entry: str  # of the plan, its name
    scene: str
    part: Part
    exact: bool  # the true pose is: see `PlanEntry.rough`
    evidence: Evidence | None  # None without a model
    rotation_error_deg: float  # infinite without a pose, and if the images are of two scenes
    translation_error_deg: float

    @property
    def right(self) -> bool:
        """Whether R and t are both within 10 degrees."""
        return max(self.rotation_error_deg, self.translation_error_deg) <= RIGHT_DEG

    @property
    def pair_error_deg(self) -> float:
        """As the matching literature counts: t without its sign."""
        return max(self.rotation_error_deg, folded(self.translation_error_deg))


def records(pairs: Iterable[StoredPair], options: EstimationOptions) -> Iterator[Record]:
    """The record of each pair, in order; `options.verdict` does not matter."""
    stored = iter(pairs)
    while chunk := list(islice(stored, _CHUNK)):
        yield from in_threads(lambda pair: record(pair, options), chunk)


def record(pair: StoredPair, options: EstimationOptions) -> Record:
    """The record of one pair."""
    truth = pair.truth
    pose = estimate_pose(
        pair.matches,
        truth.camera1,
        truth.camera2,
        replace(options, verdict=ANY_POSE),
        map_matches=pair.map_matches,
    )
    rotation = translation = math.inf
    if truth.R is not None and truth.t is not None and pose.R is not None and pose.t is not None:
        rotation = rotation_error_deg(pose.R, truth.R)
        translation = translation_error_deg(pose.t, truth.t)
    scene = (pair.entry, pair.scene, pair.part, pair.exact)
    return Record(*scene, pose.evidence, rotation, translation)
