"""The work of a worker: it holds a matcher and images, and describes, matches and estimates."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.pooling import is_known
from dgc_pose.batch.rows import BAD_INPUT, FAILED, MatchedPair, PairRow, row_of
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import DgcPoseError, ImageError
from dgc_pose.estimation import EstimationOptions, estimate_pose, of_stated
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image
from dgc_pose.matchers import MatcherOptions
from dgc_pose.pose import solve_pair

# Bytes of an image's features beside its pixels, roughly: of the encoder (7 MiB), for refinement
# (12 MiB for each part of the image that is matched), and of copies for the search of views (4).
FEATURE_BYTES = 24 * 2**20
Cameras = Mapping[str, Camera]  # by image name


@dataclass(frozen=True)
class Job:
    """The settings that all pairs of a batch share; it is sent to each worker once."""

    root: Path  # of the image names
    cameras: Cameras  # with the size of the image
    bad: Mapping[str, str]  # reasons by name, of images that are known to be unusable
    matcher: MatcherOptions
    estimation: EstimationOptions
    memory_bytes: int  # of images and features that a worker keeps
    masks: Path | None = None  # folder of the images' masks


class Worker:
    """Loads the matcher once, and does tasks. Images and features stay in memory within the bound
    of the job, the least recently used are dropped. A bad image makes its pairs bad, and stops
    nothing.

    Raises what `load_matcher` raises.
    """

    def __init__(self, job: Job) -> None:
        self.job, self.bad = job, dict(job.bad)
        self.cache = ImageCache(job.memory_bytes)
        self.matcher = job.matcher.load(self.cache)

    def describe(self, names: Sequence[str]) -> dict[str, np.ndarray | str]:
        """The coarsest features of images (cells, C) float16 by name, or why an image is bad."""
        described: dict[str, np.ndarray | str] = {}
        for name in names:
            if (image := self._image(name)) is None:
                described[name] = self.bad[name]
            else:
                described[name] = self.matcher.coarse_features(image).astype(np.float16)
        return described

    def match(self, pairs: Sequence[tuple[int, tuple[str, str]]]) -> list[MatchedPair]:
        """Pairs, each by its index and its names, as they are by themselves."""
        cameras = self.job.cameras
        return [_done(index, names, self._matched, names, cameras) for index, names in pairs]

    def estimate(
        self, pairs: Sequence[MatchedPair], cameras: Cameras, fit_cameras: bool
    ) -> list[MatchedPair]:
        """Pairs that are matched, with their poses by other cameras than before.

        fit_cameras: whether each pair fits them anew, also those that are known already.
        """
        return [
            _done(pair.row.index, pair.row.names, self._estimated, pair, cameras, fit_cameras)
            for pair in pairs
        ]

    def _matched(self, names: tuple[str, str], cameras: Cameras) -> MatchedPair:
        image1, image2 = (self._image(name) for name in names)
        if image1 is None or image2 is None:
            bad = {name: self.bad[name] for name in names if name in self.bad}
            reason = "; ".join(bad.values())
            return MatchedPair(PairRow(*names, BAD_INPUT, reason, bad_images=bad))
        pair = cameras[names[0]], cameras[names[1]]
        solved = solve_pair(image1, image2, pair, self.matcher, self.job.estimation)
        solved = replace(solved, pose=of_stated(solved.pose, pair))
        dense, exact = solved.correspondence_map, pair[0].exact and pair[1].exact
        sample = None if dense is None or exact else dense.sample
        row = row_of(names, solved.pose, solved.matches.error_px)
        return MatchedPair(row, solved.matches, sample)

    def _estimated(self, pair: MatchedPair, cameras: Cameras, fit_cameras: bool) -> MatchedPair:
        row, names = pair.row, pair.row.names
        if row.pose is None or all(self.job.cameras[name].exact for name in names):
            return pair
        camera1, camera2 = (cameras[name] for name in names)
        if row.status == "mirrored":  # perhaps by wrong cameras
            exact = camera1.exact and camera2.exact
            return pair if exact else self._matched(names, cameras)
        # Two cameras err each by itself, and so does each without an identity.
        same = camera1.identity is not None and camera1.identity == camera2.identity
        known = same and is_known(camera1) and is_known(camera2)
        matches = replace(pair.matches, weights=self.matcher.fingerprint)
        pose = estimate_pose(
            matches,
            camera1,
            camera2,
            self.job.estimation,
            map_matches=pair.map_matches,
            fit_cameras=fit_cameras or not known,
        )
        return MatchedPair(row_of(names, pose, matches.error_px), matches, pair.map_matches)

    def _image(self, name: str) -> Image | None:
        """An image; None if it cannot be used, with the reason in `bad`."""
        if name in self.bad:
            return None
        try:
            image = self.cache.read(self.job.root, name, self.job.masks)
            size = self.job.cameras[name].size
            if size is not None and tuple(size) != image.size:
                path = self.job.root / name
                raise ImageError(f"{path}: the size in its header is not that of its pixels")
            return image
        except DgcPoseError as error:
            self.bad[name] = str(error)
            return None


def _done(
    index: int, names: tuple[str, str], work: Callable[..., MatchedPair], *arguments: Any
) -> MatchedPair:
    """The outcome of work on a pair, or the pair with its error."""
    try:
        pair = work(*arguments)
    except MemoryError:  # every further pair would meet it too
        raise
    except DgcPoseError as error:
        pair = MatchedPair(PairRow(*names, BAD_INPUT, str(error)))
    except Exception as error:  # one pair of a million must not end the batch
        pair = MatchedPair(PairRow(*names, FAILED, f"{type(error).__name__}: {error}"))
    return replace(pair, row=replace(pair.row, index=index))
