"""Every kind of matcher by its name: what the commands and the benchmarks match with."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.matching.cache import ImageCache, image_cache
from dgc_pose.matching.dense import load_dense_matcher
from dgc_pose.matching.flow import FlowMatcher
from dgc_pose.matching.matcher import Matcher
from dgc_pose.matching.onnx_model import OnnxMatcher
from dgc_pose.matching.selection import MatchingOptions
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.matching.vismatch import VismatchMatcher
from dgc_pose.network.config import DEFAULT_WEIGHTS, PRESETS
from dgc_pose.network.stored import shipped
from dgc_pose.refinement import RefinementOptions, Refiner
from dgc_pose.runtime.engine import Engine
from dgc_pose.runtime.load import DEVICE_HELP, RUNTIME_HELP, RuntimeName
from dgc_pose.system.options import check_options, check_type, option


@dataclass(frozen=True)
class MatcherCaches:
    """Features of images that one matcher has computed, kept for the next pair of that image.

    Features belong to the network that made them: two matchers never share an instance. `asked` and
    `made` of each count the look-ups and the computations.

    Attributes:
        features: Features of the encoder at 240x240.
        native: Features of the encoder at native resolution, and textures, for refinement.
        key_points: Key points of a detector.
    """

    features: ImageCache = field(default_factory=image_cache)
    native: ImageCache = field(default_factory=image_cache)
    key_points: ImageCache = field(default_factory=image_cache)


@dataclass(frozen=True)
class MatcherOptions:
    """Which matcher, and how it matches. Raises InputError, naming the field, for a value out of
    range.

    Attributes:
        matching: How matches are selected from a dense map.
        refinement: How a network's matches are refined.
    """

    weights: str = option(
        DEFAULT_WEIGHTS,
        "Shipped weights by name; a file, .safetensors or an authors' .pth; or another matcher: "
        "sift, dis (optical flow), MODEL.onnx (a detector with descriptors), or vismatch:NAME.",
        metavar="NAME|FILE",
    )
    device: str = option("auto", DEVICE_HELP, metavar="NAME")
    runtime: RuntimeName = option("auto", RUNTIME_HELP, metavar="NAME", section="matching")
    half_precision: bool = option(
        False,
        "bfloat16, by torch: less exact, faster on some GPUs.",
        section="matching",
    )
    matching: MatchingOptions = field(default_factory=MatchingOptions)
    refinement: RefinementOptions = field(default_factory=RefinementOptions)

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def kind(self) -> MatcherKind:
        """The kind that the name stands for; by default a network."""
        return next(kind for kind in KINDS if fnmatchcase(self.weights, kind.pattern))

    def load(self, caches: MatcherCaches | None = None, engine: Engine | None = None) -> Matcher:
        """The matcher; see `load_matcher`. engine: of a network that is loaded already."""
        try:
            matcher = self.kind.load(self, caches, engine)
            matcher.loaded_anew = self.load
            return matcher
        except WeightsError:
            path = Path(self.weights)
            if self.weights in PRESETS or path.suffix or path.exists():
                raise
        names = ", ".join(dict.fromkeys([*shipped(), *(kind.pattern for kind in KINDS[:-1])]))
        raise InputError(f"{self.weights}: no such file, and no such matcher: there are {names}")


@dataclass(frozen=True)
class MatcherKind:
    """A kind of matcher: a row of `KINDS`."""

    pattern: str  # of the names that stand for it, as of files
    load: Callable[[MatcherOptions, MatcherCaches | None, Engine | None], Matcher]
    dense_map: bool = False  # whether it makes one
    # Whether it is a network whose features refine its matches and choose pairs.
    network: bool = False


def load_matcher(
    name: str | os.PathLike[str] = DEFAULT_WEIGHTS,
    *,
    device: str = "auto",
    runtime: RuntimeName = "auto",
    half_precision: bool = False,
    matching: MatchingOptions | None = None,
    refinement: RefinementOptions | None = RefinementOptions(),  # noqa: B008, it is frozen
    caches: MatcherCaches | None = None,
) -> Matcher:
    """A matcher by its name; by default what `dgc-pose estimate` uses.

    name: shipped weights ("dgcm-lite0"), a path to weights (see `load_network`), or a row of
    `KINDS`. device: of the network. runtime: what runs it, see `load_engine`.
    half_precision: its convolutions in bfloat16, by torch; faster on a GPU, less exact.
    matching: how matches are selected from a dense map. refinement: of a network's matches; None
    for those of its map. Other matchers are never refined here; a `Refiner` around them does it.
    caches: to keep what is computed of an image from pair to pair; None to keep it of the last
    three images alone, for a network some 30 MB each beside their pixels.

    It can be pickled and copied: what is unpickled, or the copy, is loaded anew by these arguments,
    with caches of its own, which are empty.

    Raises WeightsError if weights cannot be loaded, InputError if there is no such matcher or
    device.
    """
    check_type(name, str | os.PathLike, "name")
    if caches is not None:
        check_type(caches, MatcherCaches, "caches")
    options = MatcherOptions(
        os.fspath(name),
        device,
        runtime,
        half_precision,
        MatchingOptions() if matching is None else matching,
        RefinementOptions(source="none") if refinement is None else refinement,
    )
    return options.load(caches)


def _network(
    options: MatcherOptions, caches: MatcherCaches | None, engine: Engine | None
) -> Matcher:
    matcher = load_dense_matcher(
        options.weights,
        device=options.device,
        runtime=options.runtime,
        half_precision=options.half_precision,
        options=options.matching,
        cache=caches.features if caches else None,
        engine=engine,
    )
    if options.refinement.source == "none":
        return matcher
    native = caches.native if caches else None
    return Refiner(matcher, options.refinement.source, options.matching.max_matches, native)


# The first whose pattern the name fits. A new matcher is a row here, and a file with its class.
KINDS = (
    MatcherKind("sift", lambda _, caches, *__: SiftMatcher(caches.key_points if caches else None)),
    MatcherKind("dis", lambda options, *_: FlowMatcher(options.matching), dense_map=True),
    MatcherKind(
        "*.onnx",
        lambda of, caches, _: OnnxMatcher(of.weights, caches.key_points if caches else None),
    ),
    MatcherKind("vismatch:*", lambda options, *_: VismatchMatcher(options.weights, options.device)),
    MatcherKind("*", _network, dense_map=True, network=True),
)
