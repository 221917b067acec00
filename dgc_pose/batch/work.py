"""The work of a worker: it holds a matcher and images, and matches blocks of pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgc_pose.batch.matches_file import NO_MATCHES, FittedCameras, PairMatches, pair_matches
from dgc_pose.batch.pooling import is_known
from dgc_pose.batch.rows import BAD_INPUT, FAILED, PairRow, row_of
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import DgcPoseError
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.images.image import Image, load_image
from dgc_pose.images.mask import mask_file, masked
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching.cache import BoundedCache, image_cache
from dgc_pose.pose import solve_pair

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
        self.cache = image_cache(job.memory_bytes)
        self.matcher = job.matcher.load(self.cache)
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
        done = [self._pair(names, self.job.cameras, bad) for names in task.pairs]
        rows, matches = zip(*done, strict=True)
        return Matched(task.indices, rows, matches, bad)

    def _estimate(self, task: Estimate) -> Matched:
        rows, matches = list(task.block.rows), list(task.block.matches)
        for i, (row, stored) in enumerate(zip(rows, matches, strict=True)):
            if stored.pose_inputs is not None:
                first, second = (task.cameras[name] for name in row.names)
                # Two cameras err each by itself.
                known = is_known(first) and is_known(second) and first.identity == second.identity
                fit = task.fit_cameras or not known
                rows[i], matches[i] = self._posed(row.names, task.cameras, stored, fit)
            elif row.status == "mirrored":  # by cameras that were perhaps wrong
                if not all(task.cameras[name].exact for name in row.names):
                    rows[i], matches[i] = self._pair(row.names, task.cameras, {})
        return Matched(task.block.indices, rows, matches, {})

    def _pair(
        self, names: tuple[str, str], cameras: Mapping[str, Camera], bad: dict[str, str]
    ) -> tuple[PairRow, PairMatches]:
        """The row and the matches of a pair; the reasons of bad images are added to `bad`."""
        image1, image2 = (self._image(name) for name in names)
        if isinstance(image1, Image) and isinstance(image2, Image):
            return self._posed(names, cameras, (image1, image2))
        reasons = {n: i for n, i in zip(names, (image1, image2), strict=True) if isinstance(i, str)}
        bad.update(reasons)
        return PairRow(*names, BAD_INPUT, False, "; ".join(reasons.values())), NO_MATCHES

    def _posed(
        self,
        names: tuple[str, str],
        cameras: Mapping[str, Camera],
        given: tuple[Image, Image] | PairMatches,
        fit_cameras: bool = True,
    ) -> tuple[PairRow, PairMatches]:
        """The row and the matches of two images, or of matches as they are stored."""
        pair, options = (cameras[names[0]], cameras[names[1]]), self.job.estimation
        try:
            if isinstance(given, PairMatches):
                matches, sample = given.estimable(self.matcher.fingerprint)
                pose = estimate_pose(
                    matches, *pair, options, map_matches=sample, fit_cameras=fit_cameras
                )
                stored, error_px = given, matches.error_px
            else:
                solved = solve_pair(*given, pair, self.matcher, options)
                pose, error_px = solved.pose, solved.matches.error_px
                # Of a mirror image no camera makes a pose.
                again = not (pair[0].exact and pair[1].exact) and pose.status != "mirrored"
                stored = pair_matches(solved, estimable=again)
            fitted = None
            if pose.camera_covariance is not None and pose.camera1 and pose.camera2:
                fitted = FittedCameras((pose.camera1, pose.camera2), pose.camera_covariance)
            stored = replace(stored, inliers=pose.inliers, fitted=fitted)
            return row_of(names, pose, error_px), stored
        except DgcPoseError as error:
            return PairRow(*names, BAD_INPUT, False, str(error)), NO_MATCHES
        except MemoryError:  # every further pair would meet it too
            raise
        except Exception as error:  # one pair of a million must not end the batch
            return PairRow(*names, FAILED, False, f"{type(error).__name__}: {error}"), NO_MATCHES

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
