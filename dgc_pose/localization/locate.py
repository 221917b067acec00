"""Locate a query in a model: choose database images, match pairs, fit one pose to all pairs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dgc_pose.batch.source import similarity
from dgc_pose.cameras.by_image import KDetails
from dgc_pose.cameras.calibration import single_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.colmap.tracking import points_in
from dgc_pose.errors import ImageError, InputError
from dgc_pose.estimation import (
    EstimationOptions,
    RelativePose,
    camera_texts,
    reject_contradicted_K,
)
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image, load_image, mask_file, masked, require_matchable
from dgc_pose.localization.location import Location
from dgc_pose.localization.search import MAX_IMAGES, LocationSearch
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher
from dgc_pose.model import Model
from dgc_pose.pose import solve_pair, wants_second
from dgc_pose.system.options import check_type

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource, ImageSource


def locate(
    query: ImageSource,
    model: Model,
    K: CameraSource = None,
    *,
    matcher: Matcher | None = None,
    options: EstimationOptions | None = None,
) -> Location:
    """Estimate the pose of a query photograph in a model's frame and unit.

    query: as an image for `estimate_relative_pose`. model: from `load_model`. K: of the query, as
    for `estimate_relative_pose`; None if unknown. If the matches contradict K, the search starts
    again without it, with a warning. For many queries, use `Locator.locate_all`, which describes
    the model only once. Raises InputError and ImageError like `estimate_relative_pose`.
    """
    return Locator(model, matcher, options).locate(query, K)


class Locator:
    """Locates many queries in a model, whose images it describes only once.

    matcher: by default `load_matcher()`. masks: folder with the masks of the model's images and of
    the queries, NAME.jpg.png for NAME.jpg (`mask_file`).

    Attributes:
        bad: By name, why images of the model are not matched: those that `describe` found unusable.
    """

    def __init__(
        self,
        model: Model,
        matcher: Matcher | None = None,
        options: EstimationOptions | None = None,
        masks: Path | None = None,
    ) -> None:
        check_type(model, Model, "model")
        self.model = model
        self.matcher = matcher or load_matcher()
        self.options = options or EstimationOptions()
        self.masks = masks
        self.bad: dict[str, str] = {}
        self._features: dict[str, np.ndarray] = {}
        # A cache of only three images would read the model's images again for each query.
        cache = self.matcher.cache
        self._images = ImageCache(2**29) if cache.limit_bytes is None else cache

    def image(self, name: str) -> Image:
        """Read an image of the model with its mask. Raises ImageError; InputError for its mask."""
        return self._images.read(self.model.root, name, self.masks)

    def describe(self, progress: Callable[[int, int], None] = lambda done, of: None) -> None:
        """Compute the coarsest features of the model's images, for choosing database images. Raises
        ImageError if none is usable."""
        for done, name in enumerate(self.model.poses, start=1):
            if name not in self._features and name not in self.bad:
                try:
                    image = self.image(name)
                    require_matchable(image)
                except (ImageError, InputError) as error:
                    self.bad[name] = str(error)
                else:
                    self._features[name] = self.matcher.coarse_features(image)
            progress(done, len(self.model.poses))
        if self.bad and not self._features:
            count = f"none of the {len(self.bad)} images of the model can be used"
            raise ImageError(f"{count} (first: {next(iter(self.bad.values()))})")

    def locate_all(
        self,
        queries: Iterable[ImageSource],
        K: CameraSource = None,
        details: KDetails | None = None,
    ) -> Iterator[Location]:
        """Yield the location of each query, as `locate`. A query that cannot be used, or that K
        does not fit, has the status "bad_input"."""
        self.describe()  # what is wrong with the model is raised
        for query in queries:
            try:
                loaded = self._loaded(query, K, details)
            except (ImageError, InputError) as error:
                yield Location("bad_input", str(error), ())
            else:
                yield self._located(*loaded)

    def locate(
        self,
        query: ImageSource,
        K: CameraSource = None,
        details: KDetails | None = None,
        *,
        excluded: Sequence[str] = (),
        whole: bool = False,
        most: int = MAX_IMAGES,
    ) -> Location:
        """Estimate the pose of a query, as `locate`. details: of K. excluded: names of model images
        not to match, besides the query itself. whole: whether the query is certainly neither
        cropped nor squeezed. most: number of model images to match."""
        loaded = self._loaded(query, K, details)
        return self._located(*loaded, excluded=excluded, whole=whole, most=most)

    def _loaded(
        self, query: ImageSource, K: CameraSource, details: KDetails | None
    ) -> tuple[Image, Camera, float]:
        """A query with its mask, its camera, and the seconds taken. Raises InputError and
        ImageError."""
        start = time.perf_counter()
        image = load_image(query, "query")
        image = masked(image, mask_file(self.masks, Path(image.name).name))
        require_matchable(image)
        camera = single_camera(K, image, "K", details or KDetails())
        return image, camera, time.perf_counter() - start

    def _located(
        self,
        image: Image,
        camera: Camera,
        load_s: float,
        *,
        excluded: Sequence[str] = (),
        whole: bool = False,
        most: int = MAX_IMAGES,
    ) -> Location:
        seconds = {"load": load_s}
        start = time.perf_counter()
        same = [n for n in self.model.poses if _same_file(self.model.root / n, Path(image.name))]
        warnings = list[str]()
        if same and same[0] not in excluded:
            warnings = [f"{image.name} is in the model as {same[0]}, which is not matched"]
        self.describe()
        names = [name for name in self._features if name not in {*excluded, *same}]
        if not names:
            usable = f"{len(self._features)} of {len(self.model.poses)} images of the model"
            none = f"{usable} can be used, and besides the query none"
            lines = (*warnings, *camera.warnings)
            return Location("nowhere", none, (), camera=camera, warnings=lines, seconds=seconds)
        features = self.matcher.coarse_features(image)
        scores = {name: similarity(features, self._features[name]) for name in names}
        seconds["describe"] = time.perf_counter() - start

        names.sort(key=lambda name: -scores[name])
        seconds |= {"match": 0.0, "estimate": 0.0}
        first = replace(self.options, second="none")
        searched = partial(self._searched, image, camera, names, whole=whole, most=most)
        location = searched(first, seconds)
        is_open = not location.success and wants_second(self.options)
        if is_open and self.matcher.second_matcher is not None:
            location = searched(self.options, seconds)
        self.matcher.cache.forget(image)
        return replace(
            location,
            warnings=(*warnings, *camera.warnings, *location.warnings),
            seconds=seconds,
        )

    def _searched(
        self,
        image: Image,
        camera: Camera,
        names: Sequence[str],
        estimation: EstimationOptions,
        seconds: dict[str, float],
        *,
        whole: bool,
        most: int,
    ) -> Location:
        """The location of a query in a search. names: of the database images, the most similar
        first. seconds: the seconds of the search are added to it."""
        search = LocationSearch(self.model, camera, estimation, names, whole=whole, most=most)
        against_K = 0  # database images
        while (name := search.next_image()) is not None:
            start = time.perf_counter()
            cameras = self.model.cameras[name], search.pair_camera
            # With a nearly certain location, a further pair needs no thorough search.
            effort = "fast" if search.is_placed else estimation.effort
            options = replace(estimation, effort=effort)
            pair = solve_pair(self.image(name), image, cameras, self.matcher, options)
            matched = time.perf_counter()
            pose = reject_contradicted_K(pair.pose, cameras)
            search.add(name, pose, pair.matches, *self._points(name, image, pose, pair.matches))
            seconds["match"] += matched - start
            seconds["estimate"] += time.perf_counter() - matched
            against_K = max(against_K, search.num_against_K)
            if search.contradicts_K:
                assumed = single_camera(None, image)
                search = LocationSearch(
                    self.model, assumed, estimation, names, whole=whole, most=most
                )
        location = search.location()
        if not against_K or (location.success and search.stated is camera):
            return location
        warning = f"{image.name}: {_against(camera, location, against_K)}"
        if location.success:  # by another camera than the stated one
            warning += "; the location is without this K"
        return replace(location, warnings=(warning, *location.warnings))

    def _points(
        self, name: str, image: Image, pose: RelativePose, matches: Matches
    ) -> tuple[np.ndarray, np.ndarray]:
        """Model points (M,) int visible in a database image and the query, and their pixels (M, 2)
        in the query."""
        if name not in self.model.seen or not pose.success:
            return np.zeros(0, np.int64), np.zeros((0, 2))
        which, pixels = self.model.seen[name]
        shown = self.image(name)
        kept, seen = points_in(image, shown, matches.subset(pose.inliers), pixels)
        return which[kept], seen


def _against(stated: Camera, location: Location, count: int) -> str:
    """Why a K is contradicted. count: database images whose matches contradict it."""
    if location.camera is not None and location.success:
        for text_of_part in (camera_texts.focal, camera_texts.centre):
            if text := text_of_part(stated, location.camera):
                return f"the matches agree with {text}"
    return f"the matches with {count} of the database images contradict K"


def _same_file(first: Path, second: Path) -> bool:
    try:
        return os.path.samefile(first, second)
    except OSError:
        return False
