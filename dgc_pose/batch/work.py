"""What a worker does: it holds a matcher and images, and matches blocks of pairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dgc_pose.batch.matches_file import NO_MATCHES, PairMatches
from dgc_pose.batch.rows import PairRow, bad_row, row_of
from dgc_pose.camera import Camera
from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.image import Image, load_image
from dgc_pose.matchers import MatcherCaches, load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.matching.matcher import Matcher
from dgc_pose.matching.selection import MatchingOptions
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.refinement.options import RefinementOptions
from dgc_pose.runtime.load import RuntimeName

# Bytes of an image's features beside its pixels, roughly: of the encoder (7 MiB), and for
# refinement (12 MiB for each part of the image that is matched).
FEATURE_BYTES = 24 * 2**20


@dataclass(frozen=True)
class MatcherSettings:
    """A matcher by name and options, as `load_matcher` takes them."""

    weights: str = DEFAULT_WEIGHTS
    device: str = "auto"
    matching: MatchingOptions = field(default_factory=MatchingOptions)
    refinement: RefinementOptions | None = field(default_factory=RefinementOptions)
    runtime: RuntimeName = "auto"
    half_precision: bool = False

    def load(self, caches: MatcherCaches | None = None) -> Matcher:
        """Raises what `load_matcher` raises."""
        return load_matcher(
            self.weights,
            device=self.device,
            runtime=self.runtime,
            half_precision=self.half_precision,
            matching=self.matching,
            refinement=self.refinement,
            caches=caches,
        )


@dataclass(frozen=True)
class Job:
    """What all pairs of a batch share; it is sent to each worker once."""

    root: Path  # of the image names
    cameras: Mapping[str, Camera]  # by name, with the size of the image
    bad: Mapping[str, str]  # reasons by name, of images that are known to be unusable
    guessed: frozenset[str]  # names of the images with a guessed focal length
    matcher: MatcherSettings
    estimation: EstimationOptions
    memory_bytes: int  # of images and features that a worker keeps


@dataclass(frozen=True)
class Describe:
    """A task: the coarsest features of images."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class Match:
    """A task: the poses and matches of pairs."""

    indices: tuple[int, ...]  # of the pairs in the batch
    pairs: tuple[tuple[str, str], ...]  # image names


@dataclass(frozen=True, eq=False)
class Described:
    """The coarsest features of images."""

    features: dict[str, np.ndarray]  # (cells, C) float16 by name; absent for a bad image
    bad: dict[str, str]  # the reason by name


@dataclass(frozen=True, eq=False)
class Matched:
    """The rows and matches of a block, in the task's order."""

    indices: tuple[int, ...]
    rows: list[PairRow]
    matches: list[PairMatches]
    bad: dict[str, str]  # of images that could not be read: the reason by name


Task = Describe | Match
Outcome = Described | Matched


class Worker:
    """Loads the matcher once, and does tasks. Images and features stay in memory within the bound
    of the job, the least recently used are dropped.

    Raises what `load_matcher` raises.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.caches = MatcherCaches()
        for cache in (self.caches.features, self.caches.native, self.caches.key_points):
            cache.limit_bytes = job.memory_bytes
        self.matcher = job.matcher.load(self.caches)
        self._images: BoundedCache[str, Image | str] = BoundedCache(
            _bytes, job.memory_bytes, self._forget
        )

    def do(self, task: Task) -> Outcome:
        """The outcome of a task. A bad image makes its pairs bad, and stops nothing."""
        return self._describe(task) if isinstance(task, Describe) else self._match(task)

    def _describe(self, task: Describe) -> Described:
        dense = getattr(self.matcher, "matcher", self.matcher)
        if not hasattr(dense, "coarse_features"):
            raise InputError(
                f"--pairs auto needs the features of a network, and {self.matcher.name} has none"
            )
        features: dict[str, np.ndarray] = {}
        bad = {}
        for name in task.names:
            image = self._image(name)
            if isinstance(image, str):
                bad[name] = image
            else:
                features[name] = dense.coarse_features(image).astype(np.float16)
        return Described(features, bad)

    def _match(self, task: Match) -> Matched:
        rows, matches = [], []
        bad: dict[str, str] = {}
        for names in task.pairs:
            row, found = self._pair(names, bad)
            rows.append(row)
            matches.append(found)
        return Matched(task.indices, rows, matches, bad)

    def _pair(self, names: tuple[str, str], bad: dict[str, str]) -> tuple[PairRow, PairMatches]:
        images = [self._image(name) for name in names]
        reasons = {name: one for name, one in zip(names, images, strict=True) if _is_bad(one)}
        if reasons:
            bad.update({name: str(reason) for name, reason in reasons.items()})
            return bad_row(names, "; ".join(map(str, reasons.values()))), NO_MATCHES
        image1, image2 = (one for one in images if isinstance(one, Image))
        camera1, camera2 = (self.job.cameras[name] for name in names)
        try:
            matched = self.matcher.match(image1, image2)
            found = matched.matches
            pose = estimate_pose(
                found,
                camera1,
                camera2,
                self.job.estimation,
                map_matches=matched.map_matches,
            )
        except Exception as error:  # one pair of a million must not end the batch
            return bad_row(names, f"{type(error).__name__}: {error}"), NO_MATCHES
        row = row_of(names, pose, found.error_px, bool(self.job.guessed & {*names}))
        return row, _stored(found, pose.inliers)

    def _image(self, name: str) -> Image | str:
        """An image, or the reason why it cannot be used."""
        if name in self.job.bad:
            return self.job.bad[name]
        return self._images.get(name, lambda: self._read(name))

    def _forget(self, image: Image | str) -> None:
        """Features keep their image in memory, so they go with it."""
        if isinstance(image, Image):
            self.caches.forget(image)

    def _read(self, name: str) -> Image | str:
        try:
            image = load_image(self.job.root / name)
        except DgcPoseError as error:
            return str(error)
        size = self.job.cameras[name].size
        if size is not None and tuple(size) != image.size:
            return f"{self.job.root / name}: its header says another size than its pixels"
        return image


def _is_bad(image: Image | str) -> bool:
    return isinstance(image, str)


def _bytes(name: str, image: Image | str) -> int:
    return 0 if isinstance(image, str) else image.pixels.nbytes + FEATURE_BYTES


def _stored(found: Matches, inliers: np.ndarray) -> PairMatches:
    return PairMatches(
        found.points1.astype(np.float32),
        found.points2.astype(np.float32),
        found.confidence.astype(np.float32),
        np.asarray(inliers, dtype=bool),
    )
