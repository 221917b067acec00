"""The work of a worker: it holds a matcher and images, and matches blocks of pairs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgc_pose.batch.matches_file import NO_MATCHES, PairMatches, pair_matches
from dgc_pose.batch.pooling import camera_fits, is_known
from dgc_pose.batch.rows import BAD_INPUT, FAILED, PairRow, row_of
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import DgcPoseError
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.images.image import Image, load_image
from dgc_pose.images.mask import mask_file, masked
from dgc_pose.matchers import MatcherCaches, MatcherOptions
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.pose import pose_of_pair

# Bytes of an image's features beside its pixels, roughly: of the encoder (7 MiB), and for
# refinement (12 MiB for each part of the image that is matched).
FEATURE_BYTES = 24 * 2**20


@dataclass(frozen=True)
class Job:
    """The settings that all pairs of a batch share; it is sent to each worker once."""

    root: Path  # of the image names
    cameras: Mapping[str, Camera]  # by name, with the size of the image
    bad: Mapping[str, str]  # reasons by name, of images that are known to be unusable
    matcher: MatcherOptions
    estimation: EstimationOptions
    memory_bytes: int  # of images and features that a worker keeps
    masks: Path | None = None  # folder of the images' masks


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
class Matched:
    """The rows and matches of a block of pairs, in the task's order."""

    indices: tuple[int, ...]
    rows: Sequence[PairRow]
    matches: Sequence[PairMatches]
    bad: Mapping[str, str]  # of images that could not be read: the reason by name


@dataclass(frozen=True, eq=False)
class Estimate:
    """A task: the poses of pairs that are matched, with other cameras than before."""

    block: Matched  # a pair that cannot be estimated again keeps its row
    cameras: Mapping[str, Camera]  # of their images, by name
    fit_cameras: bool  # whether each pair fits them anew, also those that are known already


Task = Describe | Match | Estimate
Described = dict[str, np.ndarray | str]  # (cells, C) float16 by image, or why it is bad
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
            # A matcher uses two of them, and those of refinement are the larger.
            cache.limit_bytes = job.memory_bytes * 2 // 3
        self.matcher = job.matcher.load(self.caches)
        self._images: BoundedCache[str, Image | str] = BoundedCache(
            _bytes, job.memory_bytes, self._forget
        )

    def do(self, task: Task) -> Outcome:
        """The outcome of a task. A bad image makes its pairs bad, and stops nothing."""
        if isinstance(task, Describe):
            return {name: self._describe(name) for name in task.names}
        return self._match(task) if isinstance(task, Match) else self._estimate(task)

    def _describe(self, name: str) -> np.ndarray | str:
        image = self._image(name)
        if isinstance(image, str):
            return image
        return self.matcher.coarse_features(image).astype(np.float16)

    def _match(self, task: Match) -> Matched:
        bad: dict[str, str] = {}
        rows, matches = zip(
            *(self._pair(names, bad, self.job.cameras) for names in task.pairs), strict=True
        )
        return Matched(task.indices, rows, matches, bad)

    def _pair(
        self, names: tuple[str, str], bad: dict[str, str], cameras: Mapping[str, Camera]
    ) -> tuple[PairRow, PairMatches]:
        """The row and the matches of a pair; the reasons of bad images are added to `bad`."""
        image1, image2 = (self._image(name) for name in names)
        reasons = {n: i for n, i in zip(names, (image1, image2), strict=True) if isinstance(i, str)}
        bad.update(reasons)
        if isinstance(image1, str) or isinstance(image2, str):
            return PairRow(*names, BAD_INPUT, False, "; ".join(reasons.values())), NO_MATCHES

        def posed() -> tuple[PairRow, PairMatches]:
            camera1, camera2 = (cameras[name] for name in names)
            search = self.matcher.search(image1, image2)
            pose = pose_of_pair(search, camera1, camera2, self.job.estimation)
            # Of a mirror image no camera makes a pose.
            again = not (camera1.exact and camera2.exact) and pose.status != "mirrored"
            stored = pair_matches(search.last, estimable=again)
            return _posed(names, stored, pose, search.last.matches.error_px)

        return _attempt(names, posed)

    def _estimate(self, task: Estimate) -> Matched:
        def estimated(row: PairRow, stored: PairMatches) -> tuple[PairRow, PairMatches]:
            if stored.pose_inputs is None and row.status != "mirrored":
                return row, stored
            first, second = (task.cameras[name] for name in row.names)
            if stored.pose_inputs is None:  # by cameras that were perhaps wrong
                exact = first.exact and second.exact
                return (row, stored) if exact else self._pair(row.names, {}, task.cameras)
            known = is_known(first) and is_known(second) and first.identity == second.identity
            fit = task.fit_cameras or not known  # two cameras err each by itself
            names = row.names
            return _attempt(names, lambda: self._estimated(names, stored, task.cameras, fit))

        rows, matches = zip(*map(estimated, task.block.rows, task.block.matches), strict=True)
        return Matched(task.block.indices, rows, matches, {})

    def _estimated(
        self,
        names: tuple[str, str],
        stored: PairMatches,
        cameras: Mapping[str, Camera],
        fit_cameras: bool,
    ) -> tuple[PairRow, PairMatches]:
        """The row and the matches of a pair, by the pose of the matches as they are stored."""
        matches, map_matches = stored.estimable()
        matches = replace(matches, weights=self.matcher.fingerprint)  # all are of this matcher
        pose = estimate_pose(
            matches,
            cameras[names[0]],
            cameras[names[1]],
            self.job.estimation,
            map_matches=map_matches,
            fit_cameras=fit_cameras,
        )
        return _posed(names, stored, pose, matches.error_px)

    def _image(self, name: str) -> Image | str:
        """An image, or the reason why it cannot be used."""
        if name in self.job.bad:
            return self.job.bad[name]
        return self._images.get(name, lambda: self._read(name))

    def _forget(self, image: Image | str) -> None:
        """Features keep their image in memory, so they go with it."""
        if isinstance(image, Image):
            self.matcher.forget(image)

    def _read(self, name: str) -> Image | str:
        try:
            image = masked(load_image(self.job.root / name), mask_file(self.job.masks, name))
        except DgcPoseError as error:
            return str(error)
        size = self.job.cameras[name].size
        if size is not None and tuple(size) != image.size:
            return f"{self.job.root / name}: the size in its header is not that of its pixels"
        return image


def _bytes(name: str, image: Image | str) -> int:
    return 0 if isinstance(image, str) else image.pixels.nbytes + FEATURE_BYTES


def _posed(
    names: tuple[str, str], stored: PairMatches, pose: RelativePose, error_px: float
) -> tuple[PairRow, PairMatches]:
    """The row, and the matches with the inliers of the pose; error_px: that of the matches."""
    inputs = stored.pose_inputs
    if inputs is not None:
        inputs = replace(inputs, camera_fits=camera_fits(pose))
    return row_of(names, pose, error_px), replace(stored, inliers=pose.inliers, pose_inputs=inputs)


def _attempt(
    names: tuple[str, str], work: Callable[[], tuple[PairRow, PairMatches]]
) -> tuple[PairRow, PairMatches]:
    """The result of `work`, or the row of a pair whose input is unusable or that failed."""
    try:
        return work()
    except DgcPoseError as error:
        return PairRow(*names, BAD_INPUT, False, str(error)), NO_MATCHES
    except MemoryError:  # every further pair would meet it too
        raise
    except Exception as error:  # one pair of a million must not end the batch
        return PairRow(*names, FAILED, False, f"{type(error).__name__}: {error}"), NO_MATCHES
