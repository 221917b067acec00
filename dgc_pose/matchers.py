"""Every matcher by its name: what the commands and the benchmarks match with."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from dgc_pose.images.image import Image
from dgc_pose.matching.dense import DenseMatcher, FeatureCache, feature_cache, load_dense_matcher
from dgc_pose.matching.flow import FlowMatcher
from dgc_pose.matching.matcher import Matcher
from dgc_pose.matching.selection import MatchingOptions
from dgc_pose.matching.sift import KeyPointCache, SiftMatcher, key_point_cache
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.refinement.features import FeatureMatches
from dgc_pose.refinement.native import NativeCache, native_cache
from dgc_pose.refinement.options import RefinementOptions
from dgc_pose.refinement.refiner import Refiner
from dgc_pose.refinement.source import MapMatches, MatchSource
from dgc_pose.runtime.load import RuntimeName
from dgc_pose.system.options import check_type

SIFT = "sift"
_DEFAULT = RefinementOptions()
DIS = "dis"
CLASSICAL = (SIFT, DIS)  # names of the matchers without weights


@dataclass(frozen=True)
class MatcherCaches:
    """What one matcher computes of an image, kept for the next pair of that image.

    Features belong to the network that made them: two matchers never share an instance. `asked` and
    `made` of each count the look-ups and the computations.
    """

    features: FeatureCache = field(default_factory=feature_cache)  # the encoder's, at 240x240
    native: NativeCache = field(default_factory=native_cache)  # the encoder's, for refinement
    key_points: KeyPointCache = field(default_factory=key_point_cache)  # of SIFT

    def forget(self, image: Image) -> None:
        """Drop all that is kept of an image."""
        self.features.drop(lambda key: key[0] is image)
        self.native.drop(lambda key: key[0] is image)
        self.key_points.drop(lambda key: key is image)


def load_matcher(
    name: str | Path = DEFAULT_WEIGHTS,
    *,
    device: str = "auto",
    runtime: RuntimeName = "auto",
    half_precision: bool = False,
    matching: MatchingOptions | None = None,
    refinement: RefinementOptions | None = _DEFAULT,
    caches: MatcherCaches | None = None,
) -> Matcher:
    """A matcher by its name; by default what `dgc-pose estimate` uses.

    name: shipped weights ("dgcm-lite0"), a path to weights (see `load_network`), "sift", or
    "dis" (optical flow). device: of the network, "auto", "cpu" or "cuda". runtime:
    what runs it, see `load_engine`. half_precision: its convolutions in bfloat16, by torch; faster
    on a GPU, less exact. matching: how matches are selected from a dense map.
    refinement: of a network's matches; None for the matches of its map. SIFT and DIS are
    never refined here; a `Refiner` around them does it.
    caches: to keep what is computed of an image from pair to pair; None to keep nothing.

    Raises WeightsError if weights cannot be loaded, InputError if there is no such device.
    """
    check_type(name, str | Path, "name")
    check_type(device, str, "device")
    for value, kind, argument in (
        (matching, MatchingOptions, "matching"),
        (refinement, RefinementOptions, "refinement"),
        (caches, MatcherCaches, "caches"),
    ):
        if value is not None:
            check_type(value, kind, argument)
    if name == SIFT:
        return SiftMatcher(cache=None if caches is None else caches.key_points)
    if name == DIS:
        return FlowMatcher(matching)
    features, native = (None, None) if caches is None else (caches.features, caches.native)
    dense = load_dense_matcher(
        name,
        device=device,
        runtime=runtime,
        half_precision=half_precision,
        options=matching,
        cache=features,
    )
    return dense if refinement is None else refined(dense, refinement, native)


def refined(
    dense: DenseMatcher, options: RefinementOptions, cache: NativeCache | None = None
) -> Refiner:
    """A network's matcher with refinement, whose features are of the same network."""
    sources: list[MatchSource] = []
    if options.source in ("auto", "features"):
        sources.append(FeatureMatches(dense.engine, options.features, cache))
    if options.source in ("auto", "map"):
        sources.append(MapMatches())
    return Refiner(dense, sources, options.alignment)
