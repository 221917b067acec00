"""The frozen network as a matcher: images of any size in, matches in their own pixels out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.image import Image
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult
from dgc_pose.matching.selection import MatchingOptions, select_matches
from dgc_pose.matching.texture import textured
from dgc_pose.network.config import DEFAULT_WEIGHTS, INPUT_SIZE
from dgc_pose.pixels import cell_centres, rescale
from dgc_pose.runtime.engine import DecodedMap, Engine, MapFeatures
from dgc_pose.runtime.load import RuntimeName, load_engine
from dgc_pose.sampling import bilinear

# The encoder's features by image and quarter turns of it; keyed by the object, not by its pixels.
FeatureCache = BoundedCache[tuple[Image, int], MapFeatures]


def feature_cache() -> FeatureCache:
    """A cache of the default size. The images that it keeps alive count towards it."""
    return BoundedCache(lambda key, features: key[0].pixels.nbytes + features.nbytes)


class DenseMatcher(Matcher):
    """Matches by a frozen network; image 1 is its source, image 2 its target.

    cache: of the encoder's features; None to encode the images anew for each pair.

    Raises InputError if `finest` is a level that the network's mask is not made for.
    """

    def __init__(
        self,
        engine: Engine,
        options: MatchingOptions | None = None,
        cache: FeatureCache | None = None,
    ) -> None:
        self.engine = engine
        self.options = options or MatchingOptions()
        if engine.config.matchability == "network" and self.options.finest != INPUT_SIZE:
            raise InputError(
                f"the mask network of {self.name} works at {INPUT_SIZE} cells alone: finest must "
                f"be {INPUT_SIZE}, not {self.options.finest}"
            )
        self.cache = cache

    @property
    def name(self) -> str:
        return self.engine.config.name

    @property
    def fingerprint(self) -> str:
        """Of the weights: different weights of one network have different fingerprints."""
        return self.engine.fingerprint

    def match(self, image1: Image, image2: Image) -> MatchResult:
        """The map at `finest` x `finest` cells, and the matches of it that pass the options."""
        return self.match_batch([(image1, image2)])[0]

    def match_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[MatchResult]:
        """As `match` for each pair, decoded together."""
        return [
            MatchResult(textured(select_matches(found, self.options), *pair), found)
            for pair, found in zip(pairs, self.correspondence_maps(pairs), strict=True)
        ]

    def coarse_features(self, image: Image) -> np.ndarray:
        """The coarsest features of an image (cells, C) float32, of unit length over C."""
        cache = feature_cache() if self.cache is None else self.cache
        return np.concatenate(self.engine.coarsest(self._features(image, 0, cache)))

    def correspondence_maps(self, pairs: Sequence[tuple[Image, Image]]) -> list[CorrespondenceMap]:
        """The map of each pair, with the cycle error if the options ask for one.

        Pairs are decoded together. Images are encoded one by one, so that the features of an image
        are independent of the batch.
        """
        cache = feature_cache() if self.cache is None else self.cache
        found = self._rotated_maps(pairs, 0, cache)
        suggested = {
            i: self._likely_rotation(*pairs[i], cache)
            for i, one in enumerate(found)
            if one.matchability.mean() < self.options.rotate_below
        }
        for quarter_turns in sorted({*suggested.values()} - {0}):
            weak = [i for i, rotation in suggested.items() if rotation == quarter_turns]
            maps = self._rotated_maps([pairs[i] for i in weak], quarter_turns, cache)
            for i, rotated in zip(weak, maps, strict=True):
                found[i] = max((found[i], rotated), key=lambda c: float(c.matchability.mean()))
        return found

    def _likely_rotation(self, image1: Image, image2: Image, cache: FeatureCache) -> int:
        """The quarter turns of image 2 whose coarsest features are most similar to image 1's.

        This needs no decoder, and on rendered pairs it finds the rotation as well as the maps do.
        """
        source, *targets = (
            np.concatenate(self.engine.coarsest(self._features(image, turns, cache)))  # (cells, C)
            for image, turns in ((image1, 0), *((image2, turns) for turns in range(4)))
        )
        similarity = [float((source @ target.T).max(0).mean()) for target in targets]
        return similarity.index(max(similarity))

    def _rotated_maps(
        self, pairs: Sequence[tuple[Image, Image]], quarter_turns: int, cache: FeatureCache
    ) -> list[CorrespondenceMap]:
        """The maps computed with each image 2 rotated, given over image 2 as it is."""
        source = [self._features(first, 0, cache) for first, _ in pairs]
        target = [self._features(second, quarter_turns, cache) for _, second in pairs]
        finest = self.options.finest
        forward = self.engine.decode(source, target, finest)
        cycles: list[np.ndarray | None] = [None] * len(pairs)
        if self.options.cycle_px is not None:
            reverse = self.engine.decode(target, source, finest)
            cycles = [
                _cycle_error(one, other, _rotated_size(image2, quarter_turns))
                for one, other, (_, image2) in zip(forward, reverse, pairs, strict=True)
            ]
        return [
            _upright_map(*pair, quarter_turns, one, cycle)
            for pair, one, cycle in zip(pairs, forward, cycles, strict=True)
        ]

    def _features(self, image: Image, quarter_turns: int, cache: FeatureCache) -> MapFeatures:
        """The encoder's features of an image rotated by `numpy.rot90`."""

        def encode() -> MapFeatures:
            return self.engine.encode(np.ascontiguousarray(np.rot90(image.pixels, quarter_turns)))

        return cache.get((image, quarter_turns), encode)


def load_dense_matcher(
    weights: str | Path = DEFAULT_WEIGHTS,
    *,
    device: str = "auto",
    options: MatchingOptions | None = None,
    cache: FeatureCache | None = None,
    runtime: RuntimeName = "auto",
) -> DenseMatcher:
    """The network alone, without refinement: shipped weights by name, or those of a file (see
    `load_network`).

    Raises WeightsError if the weights cannot be loaded, InputError if there is no such device.
    """
    return DenseMatcher(load_engine(weights, device=device, runtime=runtime), options, cache)


def _upright_map(
    image1: Image,
    image2: Image,
    quarter_turns: int,
    found: DecodedMap,
    cycle: np.ndarray | None,
) -> CorrespondenceMap:
    """The map over image 2 as it is, of one computed with image 2 rotated.

    cycle: pixels of image 2, on the grid of the map computed.
    """
    upright, matchability = (
        np.rot90(values, -quarter_turns) for values in (found.points, found.matchability)
    )
    rows, columns = matchability.shape
    return CorrespondenceMap(
        map=rescale(upright, found.size, image1.size).astype(np.float32),
        grid=cell_centres((columns, rows), image2.size).astype(np.float32),
        matchability=np.ascontiguousarray(matchability),
        size1=image1.size,
        size2=image2.size,
        cycle=None if cycle is None else np.rot90(cycle, -quarter_turns),
    )


def _cycle_error(forward: DecodedMap, reverse: DecodedMap, size2: tuple[int, int]) -> np.ndarray:
    """Distance (H, W) float32 between each cell of image 2 and its image under both maps, in pixels
    of image 2 at size2."""
    rows, columns = reverse.matchability.shape
    returned = bilinear(reverse.points, rescale(forward.points, forward.size, (columns, rows)))
    rows, columns = forward.matchability.shape
    offset = returned - cell_centres((columns, rows), reverse.size)
    return np.linalg.norm(offset * np.divide(size2, reverse.size), axis=-1).astype(np.float32)


def _rotated_size(image: Image, quarter_turns: int) -> tuple[int, int]:
    """(width, height) of the image rotated."""
    width, height = image.size
    return (width, height) if quarter_turns % 2 == 0 else (height, width)
