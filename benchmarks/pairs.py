"""The bench-pairs protocol: every method on every pair, against the known pose.

For each pair the images are read once; each method then matches them, and the same estimator turns
its matches into a pose. A pair without a pose counts as an infinite error in every figure.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.camera import check_size
from dgc_pose.errors import ImageError, InputError
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.image import Image, load_image
from dgc_pose.metrics import folded, pose_auc, rotation_error_deg, translation_error_deg

if TYPE_CHECKING:
    from dgc_pose.matching import Matcher


@dataclass(frozen=True)
class PairResult:
    """What one method made of one pair; the fields are the columns of results.csv."""

    method: str
    image1: str
    image2: str
    true_rotation_deg: float
    status: str
    success: bool
    num_matches: int
    num_inliers: int
    inlier_ratio: float
    rotation_error_deg: float  # infinite without a pose
    translation_error_deg: float  # 0 to 180, infinite without a pose
    translation_folded_deg: float  # min(e, 180 - e), infinite without a pose
    match_seconds: float
    estimate_seconds: float


@dataclass(frozen=True)
class MethodSummary:
    """One method over all pairs; the fields are the keys of bench-pairs' JSON."""

    method: str
    pairs: int
    failures: int  # pairs without a pose
    median_rotation_deg: float  # over all pairs, a failure as infinite; so are the next two
    median_translation_deg: float
    median_translation_folded_deg: float
    auc5: float  # percent; of max(rotation, folded translation), a failure as infinite
    auc10: float
    auc20: float
    seconds_per_pair: float  # mean time to match and estimate, without reading the images


def require_images(pairs: Sequence[Pair]) -> None:
    """Raise ImageError, with the path, where an image of the list is not there: better now than
    after an hour of work."""
    for pair in pairs:
        for path in (pair.path1, pair.path2):
            if not path.is_file():
                raise ImageError(f"{path}: no such image; it is named in the pair list")


def run(
    pairs: Sequence[Pair], methods: Mapping[str, Matcher], options: EstimationOptions
) -> Iterator[PairResult]:
    """Yield a result for every pair and method, pair by pair, as each is done.

    Raises ImageError for an image that cannot be read, InputError where a K cannot belong to it.
    """
    for pair in pairs:
        image1, image2 = load_image(pair.path1), load_image(pair.path2)
        for camera, image in ((pair.camera1, image1), (pair.camera2, image2)):
            check_size(camera, image.size, f"K of {image.name}")
        for name, matcher in methods.items():
            yield _run_one(pair, name, matcher, image1, image2, options)


def summarise(results: Sequence[PairResult]) -> MethodSummary:
    """The figures of one method from its results on all pairs.

    Raises InputError where there are no results or they are of several methods.
    """
    names = {result.method for result in results}
    if len(names) != 1:
        raise InputError(f"results of one method are needed, not of {len(names)}")
    rotation = np.array([result.rotation_error_deg for result in results])
    translation = np.array([result.translation_error_deg for result in results])
    folded_translation = np.array([result.translation_folded_deg for result in results])
    auc5, auc10, auc20 = pose_auc(np.maximum(rotation, folded_translation), (5, 10, 20))
    seconds = [result.match_seconds + result.estimate_seconds for result in results]
    return MethodSummary(
        method=names.pop(),
        pairs=len(results),
        failures=sum(not result.success for result in results),
        median_rotation_deg=float(np.median(rotation)),
        median_translation_deg=float(np.median(translation)),
        median_translation_folded_deg=float(np.median(folded_translation)),
        auc5=auc5,
        auc10=auc10,
        auc20=auc20,
        seconds_per_pair=float(np.mean(seconds)),
    )


def _run_one(
    pair: Pair,
    name: str,
    matcher: Matcher,
    image1: Image,
    image2: Image,
    options: EstimationOptions,
) -> PairResult:
    start = time.perf_counter()
    matches = matcher.match(image1, image2).matches
    matched = time.perf_counter()
    pose = estimate_pose(matches, pair.camera1, pair.camera2, options)
    estimated = time.perf_counter()
    rotation, translation = pose_errors(pose, pair.R, pair.t)
    return PairResult(
        method=name,
        image1=pair.name1,
        image2=pair.name2,
        true_rotation_deg=rotation_error_deg(pair.R, np.eye(3)),
        status=pose.status,
        success=pose.success,
        num_matches=pose.num_matches,
        num_inliers=pose.num_inliers,
        inlier_ratio=pose.inlier_ratio,
        rotation_error_deg=rotation,
        translation_error_deg=translation,
        translation_folded_deg=folded(translation),
        match_seconds=matched - start,
        estimate_seconds=estimated - matched,
    )


def pose_errors(pose: RelativePose, R: np.ndarray, t: np.ndarray) -> tuple[float, float]:
    """Rotation and translation error in degrees against the true R (3, 3) and t (3,).

    Both are infinite unless both R and t are known.
    """
    if not pose.success or pose.R is None or pose.t is None:
        return np.inf, np.inf
    return rotation_error_deg(pose.R, R), translation_error_deg(pose.t, t)
