"""The frozen network as a matcher of images of any size."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import cell_centres, rescale, within
from dgc_pose.geometry.sampling import bilinear
from dgc_pose.images.image import Image
from dgc_pose.matching.cache import ImageCache, LastImages
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult
from dgc_pose.matching.search import search_views
from dgc_pose.matching.selection import WEAK, MatchingOptions, select_matches
from dgc_pose.matching.view import View
from dgc_pose.network.config import DEFAULT_WEIGHTS, INPUT_SIZE
from dgc_pose.runtime.engine import DecodedMap, Engine, MapFeatures
from dgc_pose.runtime.load import RuntimeName, load_engine


class DenseMatcher(Matcher):
    """Matches by a frozen network; image 1 is its source, image 2 its target.

    cache: of the encoder's features, by view; None to keep those of the last three images.
    search_below: the network is trained on upright photographs of similar scale; if the mean
    matchability is below this, other rotations of image 2 and other scales are searched.

    Raises InputError if `finest` is a level that the network's mask is not made for.
    """

    engine: Engine
    cache: ImageCache

    def __init__(
        self,
        engine: Engine,
        options: MatchingOptions | None = None,
        cache: ImageCache | None = None,
        search_below: float = WEAK,
    ) -> None:
        self.engine = engine
        self.search_below = search_below
        self.name = engine.config.name
        self.options = options or MatchingOptions()
        if engine.config.matchability == "network" and self.options.finest != INPUT_SIZE:
            raise InputError(
                f"the mask network of {self.name} works at {INPUT_SIZE} cells alone: finest must "
                f"be {INPUT_SIZE}, not {self.options.finest}"
            )
        self.cache = cache or LastImages()

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the weights: different weights of one network have different ones."""
        return self.engine.fingerprint

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """The map at `finest` x `finest` cells, and its matches that pass the options."""
        dense = self.correspondence_map(image1, image2)
        matches = select_matches(dense, self.options)
        return MatchResult(replace(matches, weights=self.fingerprint), dense)

    def coarse_map(self, image1: Image, image2: Image) -> CorrespondenceMap | None:
        """As `Matcher`; None for a mask network, which needs the finest map."""
        if self.engine.config.matchability == "network":
            return None
        options = replace(self.options, finest=60, cycle_px=None)
        coarser = DenseMatcher(self.engine, options, self.cache, search_below=0.0)
        return coarser.correspondence_map(image1, image2)

    def coarse_features(self, image: Image) -> np.ndarray:
        """As `Matcher`; those of the whole image."""
        view = View.whole(image.size)
        features = self.cache.get((image, view), partial(self._encode, image, view))
        return np.concatenate(self.engine.coarsest(features))

    def correspondence_map(self, image1: Image, image2: Image) -> CorrespondenceMap:
        """The map of a pair, with the cycle error if the options ask for it."""
        images = image1, image2
        views = View.whole(image1.size), View.whole(image2.size)
        decoded = self._decode(images, views)
        mean = decoded[0].matchability.mean()
        if mean < self.search_below and (likely := search_views(self.engine, *images)):
            again = self._decode(images, likely)
            matchability = again[0].matchability
            inside = likely[1].inside(image2.size, matchability.shape[::-1])
            if matchability[inside].mean() > mean:
                views, decoded = likely, again
        return self._upright_map(*images, *views, *decoded)

    def _encode(self, image: Image, view: View) -> MapFeatures:
        return self.engine.encode(view.cut(image.pixels))

    def _decode(
        self, images: tuple[Image, Image], views: tuple[View, View]
    ) -> tuple[DecodedMap, np.ndarray | None]:
        """The map between views of both images, and the cycle error if the options ask for it."""
        keys = zip(images, views, strict=True)
        source, target = self.cache.get_all(
            [(key, partial(self._encode, *key)) for key in keys],
            in_turn=not self.engine.concurrent,
        )
        forward = self.engine.decode(source, target, self.options.finest)
        if self.options.cycle_px is None:
            return forward, None
        reverse = self.engine.decode(target, source, self.options.finest)
        return forward, _cycle_error(forward, reverse, views[1])

    def _upright_map(
        self,
        image1: Image,
        image2: Image,
        view1: View,
        view2: View,
        decoded: DecodedMap,
        cycle: np.ndarray | None,
    ) -> CorrespondenceMap:
        """The map over image 2 as it is, from a map between views; with matchability 0 where the
        view of image 2 shows nothing."""
        values = [decoded.points, decoded.matchability, *(() if cycle is None else (cycle,))]
        cells = decoded.matchability.shape[::-1]
        grid = cell_centres(cells, image2.size)
        if view2 != View.whole(image2.size):
            size = self.engine.config.input_size(image2.size)
            columns, rows = (side * self.options.finest // INPUT_SIZE for side in size)
            grid = cell_centres((columns, rows), image2.size)
            in_view = view2.to_view(grid)
            values = [bilinear(value, rescale(in_view, view2.size, cells)) for value in values]
            values[1] = np.where(within(in_view, view2.size), values[1], np.float32(0))
        points1 = view1.to_image(rescale(values[0], decoded.size, view1.size))
        return CorrespondenceMap(
            map=points1.astype(np.float32),
            grid=grid.astype(np.float32),
            matchability=np.ascontiguousarray(values[1]),
            size1=image1.size,
            size2=image2.size,
            cycle=None if cycle is None else values[2],
        ).masked(image1, image2)


def load_dense_matcher(
    weights: str | Path = DEFAULT_WEIGHTS,
    *,
    device: str = "auto",
    options: MatchingOptions | None = None,
    cache: ImageCache | None = None,
    runtime: RuntimeName = "auto",
    half_precision: bool = False,
    engine: Engine | None = None,
) -> DenseMatcher:
    """The network alone, without refinement: shipped weights by name, or those of a file (see
    `load_network`). device, runtime, half_precision: see `load_engine`, also for what is raised.
    engine: of these weights, if it is loaded already.
    """
    engine = engine or load_engine(
        weights, device=device, runtime=runtime, half_precision=half_precision
    )
    return DenseMatcher(engine, options, cache)


def _cycle_error(forward: DecodedMap, reverse: DecodedMap, view2: View) -> np.ndarray:
    """Distance (H, W) float32 between each cell of image 2's view and its image under both maps, in
    pixels of image 2."""
    cells1, cells2 = (decoded.matchability.shape[::-1] for decoded in (reverse, forward))
    returned = bilinear(reverse.points, rescale(forward.points, forward.size, cells1))
    offset = returned - cell_centres(cells2, reverse.size)
    pixel = np.divide(view2.size, reverse.size) / view2.scale
    return np.linalg.norm(offset * pixel, axis=-1).astype(np.float32)
