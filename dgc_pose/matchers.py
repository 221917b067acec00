"""Matchers by name: the network's weights, SIFT, optical flow, detectors and vismatch."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.matching import Matcher, MatchingOptions, NetworkMatcher
from dgc_pose.matching.cache import ImageCache
from dgc_pose.matching.flow import FlowMatcher
from dgc_pose.matching.key_points import SiftMatcher
from dgc_pose.matching.onnx_model import OnnxMatcher
from dgc_pose.matching.vismatch import PREFIX, VismatchMatcher
from dgc_pose.network.config import DEFAULT_WEIGHTS, PRESETS
from dgc_pose.network.stored import shipped
from dgc_pose.runtime.engine import Engine
from dgc_pose.runtime.load import DEVICE_HELP, RUNTIME_HELP, RuntimeName, load_engine
from dgc_pose.system.options import check_options, check_type, option

_ONNX = ".onnx"
NAMES = ("sift", "dis", f"*{_ONNX}", f"{PREFIX}*")  # of the matchers that are no network of ours


@dataclass(frozen=True)
class MatcherOptions:
    """Which matcher, and how it matches. Raises InputError, naming the field, for a value out of
    range.

    Attributes:
        matching: How matches are selected from a dense map and refined.
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
        False, "bfloat16, by torch: less exact, faster on some GPUs.", section="matching"
    )
    matching: MatchingOptions = field(default_factory=MatchingOptions)

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def is_network(self) -> bool:
        """Whether the name is that of a network of ours, whose features refine its matches and
        choose pairs."""
        is_other = self.weights in ("sift", "dis") or self.weights.startswith(PREFIX)
        return not (is_other or self.weights.endswith(_ONNX))

    @property
    def has_map(self) -> bool:
        """Whether the matcher makes a dense map."""
        return self.is_network or self.weights == "dis"

    def load(self, cache: ImageCache | None = None, engine: Engine | None = None) -> Matcher:
        """The matcher; see `load_matcher`. engine: of a network that is loaded already."""
        name = self.weights
        if name == "sift":
            return SiftMatcher(cache)
        if name == "dis":
            return FlowMatcher(self.matching)
        if name.startswith(PREFIX):
            return VismatchMatcher(name, self.device)
        if name.endswith(_ONNX):
            return OnnxMatcher(name, cache)
        try:
            engine = engine or load_engine(
                name, device=self.device, runtime=self.runtime, half_precision=self.half_precision
            )
        except WeightsError:
            if name in PRESETS or Path(name).suffix or Path(name).exists():
                raise
            names = ", ".join([*shipped(), *NAMES])
            raise InputError(
                f"{name}: no such file, and no such matcher: there are {names}"
            ) from None
        return NetworkMatcher(engine, self.matching, cache)


def load_matcher(
    name: str | os.PathLike[str] = DEFAULT_WEIGHTS,
    *,
    device: str = "auto",
    runtime: RuntimeName = "auto",
    half_precision: bool = False,
    matching: MatchingOptions | None = None,
    cache: ImageCache | None = None,
) -> Matcher:
    """A matcher by its name; by default what `dgc-pose estimate` uses.

    name: shipped weights ("dgcm-lite0"), a path to weights (see `load_network`), or one of `NAMES`.
    device: of the network. runtime: what runs it, see `load_engine`. half_precision: its
    convolutions in bfloat16, by torch; faster on a GPU, less exact. matching: how matches are
    selected from a dense map and refined. cache: `image_cache(bytes)` to keep what is computed of
    an image from pair to pair, of one matcher alone; None to keep it of the last three images, for
    a network some 35 MB each beside their pixels.

    Raises WeightsError if weights cannot be loaded, InputError if there is no such matcher or
    device.
    """
    check_type(name, str | os.PathLike, "name")
    check_type(cache, ImageCache | None, "cache")
    matching = MatchingOptions() if matching is None else matching
    options = MatcherOptions(os.fspath(name), device, runtime, half_precision, matching)
    return options.load(cache)
