"""The search for a query's pose: match one database image after another, and estimate the pose from
all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from dgc_pose.cameras.camera import Camera, image_size
from dgc_pose.cameras.prior import FAR_OFF, MOUNTED_STD
from dgc_pose.estimation import EstimationOptions, RelativePose, camera_texts
from dgc_pose.estimation.camera_changes import is_edited
from dgc_pose.estimation.covariance import error_radius, error_radius_deg
from dgc_pose.estimation.intrinsics_prior import SIZE, IntrinsicsPrior, with_parameters
from dgc_pose.estimation.problem import Hypothesis, TwoViewProblem
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.localization.correspondences import (
    Correspondences,
    PairCorrespondences,
    PointCorrespondences,
    WorldPose,
)
from dgc_pose.localization.fit import fitted, located, world_covariance
from dgc_pose.localization.location import DatabaseImage, Location, small_errors_probability
from dgc_pose.localization.picture import picture_text
from dgc_pose.matches import Matches
from dgc_pose.model import Model

MAX_IMAGES = 8  # database images to match at most
_HOPELESS = 5  # database images without a likely pose that end the search
_MIN_POINTS = 12  # model points with which a single database image determines the distance
_KNOWN_FOCAL_STD = 0.01  # of ln f; below it, the camera counts as exact in further pairs
_LIKELY = 0.1  # a pair's pose of higher probability is likely
_ACCURATE_DEG = 0.05  # a sufficient error of R
_ACCURATE_SHARE = 0.001  # a sufficient error of the centre / extent
_MIN_AGREEING = 3  # database images that must agree for the errors to suffice
_MIN_AGAINST_K = 2  # more than half of at least this many database images contradict a wrong K
_CANDIDATES = 12  # most similar database images, the candidates for the next one
_PAIR_ERROR = 0.005  # error of a pair's direction, radians, for the choice of the next image
# For an image that may be cropped or squeezed, standard deviations of its centre, over the longer
# side, and of ln fy / fx.
_EDITED_STDS = 0.1, 0.3
# Least ln fy / fx that is worth a warning; deviations by which it and the centre are unusual.
_SQUEEZED = 0.02
_UNUSUAL_STDS = 3.0
_CHANCE = 0.1  # probability that a wrong pair agrees with a wrong location
_MOST_PROBABLE = 0.99  # limit of a pair's probability
_MAX_RELATIVE_STD = 0.2  # of the position, over the distance to the database images
_ERROR_FACTOR = 1.75  # expected errors over those of the jackknife: docs/experiments.md


@dataclass(frozen=True, eq=False)
class Pair:
    """A database image that was matched with the query."""

    name: str
    pose: RelativePose  # camera 1 took the database image
    matches: Matches
    points: np.ndarray  # (M,) int, model points visible in the query
    seen: np.ndarray  # (M, 2) their pixels in the query

    @property
    def probability(self) -> float:
        """Probability that one of the hypotheses is right; 0.5 for a pose without a probability."""
        known = self.pose.any_probability
        likely = 0.5 * self.pose.success if known is None else known
        return likely * self.pose.same_place_probability


class LocationSearch:
    """The search for the pose of one query.

    names: of the model images to match, the most similar first. camera: of the query. whole:
    whether the query is certainly neither cropped nor squeezed. most: database images to match.
    """

    def __init__(
        self,
        model: Model,
        camera: Camera,
        options: EstimationOptions,
        names: Sequence[str],
        *,
        whole: bool = False,
        most: int = MAX_IMAGES,
    ) -> None:
        self.model = model
        self.camera = replace(camera, identity=None)
        self.options = options
        self.stated = camera
        self.waiting = list(names)
        self.whole = whole
        self.most = most
        self.pairs: list[Pair] = []
        # By name: for the pairs with hypotheses, and for those that support the common pose.
        self.correspondences: dict[str, PairCorrespondences] = {}
        self.agreeing: dict[str, PairCorrespondences] = {}
        self.shown: list[PointCorrespondences] = []
        self.pose: WorldPose | None = None
        self.fitted = camera
        self.covariance: np.ndarray | None = None

    def add(
        self, name: str, pose: RelativePose, matches: Matches, points: np.ndarray, seen: np.ndarray
    ) -> None:
        """Add the pair with the database image `name`, and estimate the pose from all pairs.
        points, seen: model points (M,) int visible in the query, and their pixels (M, 2) there."""
        self.waiting.remove(name)
        self.pairs.append(Pair(name, pose, matches, points, seen))
        useful = [pair for pair in self.pairs if pair.pose.hypotheses and pair.probability > 0]
        if not useful or useful[-1] is not self.pairs[-1]:
            return  # nothing new is known
        if len(useful) + sum(len(pair.points) >= _MIN_POINTS for pair in useful) < 2:
            return
        if not self.correspondences:
            self.camera = self._start_camera(useful)
        self.correspondences |= {
            p.name: self._correspondences(p) for p in useful if p.name not in self.correspondences
        }
        pairs = list(self.correspondences.values())
        self.shown = [self._points(pair) for pair in useful if len(pair.points)]
        prior = IntrinsicsPrior.of(self.model.cameras[name], self.camera)
        self.pose = located(pairs, self.shown, prior, self.options, self.pose)
        if self.pose is None:
            return
        share, aspect_std = (MOUNTED_STD, 0.0) if self.whole else _EDITED_STDS
        centre_std = share * max(self.camera.size or (0,))
        if is_edited(self.stated) and self.camera.centre_std < centre_std:
            self.camera = replace(self.camera, centre_std=centre_std, aspect_std=aspect_std)
            prior = IntrinsicsPrior.of(self.model.cameras[name], self.camera)
            self.pose = fitted([*pairs, *self.shown], self.pose, prior)
        found = self.pose
        self.agreeing = {n: c for n, c in self.correspondences.items() if c.supports(found)}
        self.covariance = world_covariance([*pairs, *self.shown], found, prior)
        if self.covariance is None:
            return
        self.covariance *= _ERROR_FACTOR**2
        self.fitted = with_parameters(self.camera, found.parameters)
        if len(prior):
            variances = prior.covariance(self.covariance[6:, 6:]).diagonal()
            known = self.fitted.with_deviations(variances[SIZE:])
            self.fitted = replace(known, focal_source="matches", focal_prior=None)

    @property
    def is_placed(self) -> bool:
        """Whether the location is nearly certain."""
        return len(self.agreeing) > 1 and self._by_pairs() > _MOST_PROBABLE

    @property
    def num_against_K(self) -> int:
        """The number of database images whose matches with the query contradict a stated K."""
        return sum(pair.pose.contradicts_K for pair in self.pairs)

    @property
    def contradicts_K(self) -> bool:
        """Whether most database images contradict the K of the query."""
        return 2 * self.num_against_K > max(len(self.pairs), _MIN_AGAINST_K)

    @property
    def pair_camera(self) -> Camera:
        """The camera for the next pair: exact if well known; as stated if most pairs disagree."""
        if 2 * len(self.agreeing) < len(self.correspondences):
            return self.stated
        is_known = 0 < self.fitted.focal_std < _KNOWN_FOCAL_STD
        return self.fitted.as_exact() if is_known else self.fitted

    def _start_camera(self, pairs: Sequence[Pair]) -> Camera:
        """The camera that normalises the problems: from the pair with the likeliest pose."""
        fits = [pair.pose for pair in pairs if pair.pose.camera2 is not None]
        if self.camera.exact or not fits:
            return self.camera
        best = max(fits, key=lambda pose: pose.probability or 0.0).camera2
        assert best is not None
        if self.whole:  # the pair's camera may be squeezed or off centre
            best = replace(best, K=self.camera.with_focal(best.focal).K)
        return replace(
            best,
            focal_std=self.camera.focal_std,
            centre_std=self.camera.centre_std,
            lens_std=self.camera.lens_std if best.lens_std else 0.0,
            aspect_std=self.camera.aspect_std,
        )

    def _correspondences(self, pair: Pair) -> PairCorrespondences:
        pose = self.model.poses[pair.name]
        camera = self.model.cameras[pair.name]
        problem = TwoViewProblem.of(pair.matches, camera, self.camera, self.options)
        hypotheses = [Hypothesis.of_pose(problem, h.R, h.t) for h in pair.pose.hypotheses]
        return PairCorrespondences(pose[:, :3], self.model.centre(pair.name), problem, hypotheses)

    def _points(self, pair: Pair) -> PointCorrespondences:
        camera = self.camera
        threshold = self.correspondences[pair.name].threshold
        seen = camera.normalise(pair.seen)
        points = self.model.points[pair.points]
        return PointCorrespondences(points, seen, camera.distortion, threshold)

    def next_image(self) -> str | None:
        """The database image to match next; None to end the search."""
        if not self.waiting or len(self.pairs) >= self.most or self._accurate():
            return None
        if len(self.pairs) >= _HOPELESS and max(p.probability for p in self.pairs) <= _LIKELY:
            return None
        if self.pose is None or self.covariance is None or len(self.agreeing) < 2:
            return self.waiting[0]
        information = np.linalg.pinv(self.covariance[3:6, 3:6])
        left = [self._variance_with(self.pose, information, n) for n in self.waiting[:_CANDIDATES]]
        return self.waiting[int(np.argmin(left))]

    def _variance_with(self, pose: WorldPose, information: np.ndarray, name: str) -> float:
        """The variance of the centre after a further database image. The image adds information
        across its line of sight: more if it is nearer and if it faces in the same direction."""
        sight = self.model.centre(name) - pose.centre
        distance = max(float(np.linalg.norm(sight)), 1e-12)
        across = np.eye(3) - np.outer(sight, sight) / distance**2
        facing = max(float(pose.R[2] @ self.model.poses[name][2, :3]), 0.0)  # cosine of the axes
        added = across * (facing / (_PAIR_ERROR * distance)) ** 2
        return float(np.trace(np.linalg.pinv(information + added)))

    def _accurate(self) -> bool:
        if self.covariance is None or len(self.agreeing) < _MIN_AGREEING or not self._is_located():
            return False
        rotation = error_radius_deg(self.covariance[:3, :3])
        position = error_radius(self.covariance[3:6, 3:6])
        return rotation < _ACCURATE_DEG and position < _ACCURATE_SHARE * self.model.extent

    def location(self) -> Location:
        """The location from the database images matched so far."""
        matched = tuple(map(self._matched, self.pairs))
        pose = self.pose
        none_agree = tuple(replace(image, agrees=False) for image in matched)
        if reason := self._why_picture():
            return Location("nowhere", reason, none_agree, camera=self.camera)
        if pose is not None and self.covariance is not None and self._is_located():
            # The probability of a location is tested for the network's matches alone.
            poses = [pair.pose for pair in self.pairs]
            is_known = not any(p.any_probability is None or p.tested_matchers for p in poses)
            right = self._probability() * small_errors_probability(
                self.covariance, self.model.extent
            )
            return Location(
                "located",
                "",
                matched,
                pose.R,
                pose.centre,
                covariance=self.covariance[:6, :6],
                probability=right if is_known else None,
                camera=self.fitted,
                stated=self.stated,
                warnings=self._unusual_camera(),
            )
        likely = [pair for pair in self.pairs if pair.pose.success]
        # R of the query, cam_from_world, from each pair with a pose.
        rotations = {
            pair.name: pair.pose.hypotheses[0].R @ self.model.poses[pair.name][:, :3]
            for pair in likely
        }
        if reason := self._why_nowhere([*rotations.values()]):
            return Location("nowhere", reason, none_agree, camera=self.camera)
        best = max(likely, key=lambda pair: pair.pose.probability or 0.0)
        R = rotations[best.name]
        t = best.pose.hypotheses[0].t
        camera = self.camera
        why = f"only {best.name} has a pose"
        if pose is not None and len(likely) > 1:
            R = pose.R
            t = self.correspondences[best.name].pair_pose(pose)[1]
            camera = self.fitted
            why = "they lie on one line of sight"
        return Location(
            "no_scale",
            f"the database images do not determine the distance from {best.name}: {why}",
            matched,
            R,
            direction=-R.T @ t,
            direction_from=best.name,
            camera=camera,
        )

    def _unusual_camera(self) -> tuple[str, ...]:
        """Warnings about what cropping or squeezing did to the fitted camera of the query."""
        camera = self.fitted
        K = self.stated.K
        if not is_edited(self.stated):
            return ()
        squeeze = abs(math.log(camera.K[1, 1] / camera.K[0, 0] * K[0, 0] / K[1, 1]))
        shift = float(np.abs(camera.K[:2, 2] - K[:2, 2]).max())
        texts = []
        if squeeze > max(_SQUEEZED, _UNUSUAL_STDS * camera.aspect_std):
            texts.append(camera_texts.squeezed(camera))
        if shift > max(FAR_OFF * max(image_size(camera)), _UNUSUAL_STDS * camera.centre_std):
            texts.append(camera_texts.off_centre(camera))
        return tuple(f"the matches agree with {text}" for text in texts)

    def _why_picture(self) -> str:
        """Why the query is a picture of the place; empty for another one."""
        if self.pose is None or self.whole:
            return ""
        every: list[Correspondences] = [*self.correspondences.values(), *self.shown]
        database = self.model.cameras[self.pairs[0].name]
        text = picture_text(every, self.pose, database, self.camera, self.stated)
        return f"the query looks like a picture of the place: {text}" if text else ""

    def _why_nowhere(self, rotations: Sequence[np.ndarray]) -> str:
        """Why the query has no rotation; empty if it has one. rotations: (3, 3), from each pair."""
        mirrored = sum(pair.pose.status == "mirrored" for pair in self.pairs)
        if mirrored and mirrored >= len(rotations):
            return f"the mirror image of the query fits {mirrored} database images: flip the query"
        if not rotations:
            return f"none of {len(self.pairs)} database images has a likely pose"
        if len(rotations) == 1 or (self.pose is not None and self._is_claimed()):
            return ""
        angles = [rotation_angle_deg(R1 @ R2.T) for R1, R2 in combinations(rotations, 2)]
        return (
            f"{len(rotations)} database images disagree on the rotation of the query, by "
            f"{np.median(angles):.0f} degrees (median)"
        )

    def _is_located(self) -> bool:
        """Whether the location is probable, and the distance from the images is determined."""
        if self.pose is None or self.covariance is None or not self.agreeing:
            return False
        centres = np.stack([c.centre for c in self.agreeing.values()])
        distance = float(np.median(np.linalg.norm(centres - self.pose.centre, axis=1)))
        std = math.sqrt(float(np.linalg.eigvalsh(self.covariance[3:6, 3:6])[-1]))
        return self._is_claimed() and std <= _MAX_RELATIVE_STD * distance

    def _is_claimed(self) -> bool:
        return self._probability() >= (self.options.min_probability or 0)

    def _probability(self) -> float:
        """Probability that the location is right. Its limit is the best same-place probability of a
        pair, because a look-alike place deceives all pairs at once."""
        agreeing = [pair.pose for pair in self.pairs if pair.name in self.agreeing]
        surest = max((pose.same_place_probability for pose in agreeing), default=0.0)
        return min(surest, self._by_pairs())

    def _by_pairs(self) -> float:
        """Probability that the location is right, for pairs with independent errors: either exactly
        the agreeing pairs are right, or all pairs are wrong and agree by chance. A pair that is
        mirrored or contradicts K is evidence against the location."""
        log_odds = (1 - len(self.agreeing)) * math.log(_CHANCE)
        for pair in self.pairs:
            against = pair.pose.status == "mirrored" or pair.pose.contradicts_K
            likely = 1.0 if against else pair.probability
            right = min(max(likely, 1 - _MOST_PROBABLE), _MOST_PROBABLE)
            log_odds += math.log(right / (1 - right) if pair.name in self.agreeing else 1 - right)
        return 1 / (1 + math.exp(-log_odds))

    def _matched(self, pair: Pair) -> DatabaseImage:
        agreeing = self.agreeing.get(pair.name)
        inliers = pair.pose.inliers
        if agreeing is not None and self.pose is not None:
            inliers = np.zeros(len(pair.matches), dtype=bool)
            inliers[agreeing.problem.index] = agreeing.hypothesis(self.pose).inliers_in_front
        likely = None if pair.pose.any_probability is None else pair.probability
        agrees = agreeing is not None
        shown = (pair.points, pair.seen)
        return DatabaseImage(pair.name, pair.matches, inliers, likely, agrees, *shown)
