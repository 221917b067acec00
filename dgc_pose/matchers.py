"""Matchers by name: networks with their weights and runtime, SIFT, detectors and vismatch."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal, NamedTuple

from dgc_pose.errors import ArgumentName, InputError, WeightsError, is_installed, require
from dgc_pose.images.cache import ImageCache
from dgc_pose.matching import Matcher, MatchingOptions, NetworkMatcher
from dgc_pose.matching.key_points import OnnxMatcher, SiftMatcher
from dgc_pose.matching.lightglue import LightGlueMatcher
from dgc_pose.matching.vismatch import PREFIX, VismatchMatcher
from dgc_pose.network.config import DEFAULT_WEIGHTS, PRESETS
from dgc_pose.network.weights import SUFFIX, choose_device, find_weights, load_network, shipped
from dgc_pose.runtime.engine import Engine
from dgc_pose.system.options import check_options, check_type, option

RuntimeName = Literal["auto", "onnx", "torch"]
DEVICE_HELP = "auto, cpu, cuda or cuda:N."
RUNTIME_HELP = (
    "onnx: ONNX Runtime, on the CPU; torch; auto: onnx for dgcm-lite0 on the CPU, else torch."
)
_DRIVERS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # devices of GPUs, on Linux and in WSL


class NamedMatcher(NamedTuple):
    """A row of the table of matchers other than our networks."""

    name: str  # as a user states it; capitals stand for any characters
    about: str  # in the documentation
    make: Callable[[MatcherOptions, ImageCache | None], Matcher]
    uses_device: bool = False  # else it runs on the CPU only

    def fits(self, name: str) -> bool:
        """Whether a name is of this row."""
        return fnmatchcase(name, re.sub("[A-Z]+", "*", self.name))


# docs/library.md and the help of --weights show the table. The first row that fits a name counts.
MATCHERS: Sequence[NamedMatcher] = (
    NamedMatcher(
        SiftMatcher.name,
        "OpenCV's SIFT: ratio test, mutual check",
        lambda options, cache: SiftMatcher(cache),
    ),
    NamedMatcher(
        LightGlueMatcher.name,
        "ALIKED's key points matched by LightGlue (`pip install ./lightglue`)",
        lambda options, cache: LightGlueMatcher(cache),
    ),
    NamedMatcher(
        f"{PREFIX}NAME",
        "a matcher of the package vismatch (`pip install vismatch`; it downloads weights under "
        "their licences)",
        lambda options, cache: VismatchMatcher(options.weights, options.device),
        uses_device=True,
    ),
    NamedMatcher(
        "MODEL.onnx",
        "a detector with descriptors of your own",
        lambda options, cache: OnnxMatcher(options.weights, cache),
    ),
)
NAMES = tuple(matcher.name for matcher in MATCHERS)


@dataclass(frozen=True)
class MatcherOptions:
    """The matcher and its settings. Raises InputError, naming the field, for a value out of range.

    Attributes:
        matching: How matches are selected from a dense map and refined.
    """

    weights: str = option(
        DEFAULT_WEIGHTS,
        "Shipped weights by name; a file, .safetensors or an authors' .pth; or another matcher: "
        f"{', '.join(NAMES)}.",
        metavar="NAME|FILE",
    )
    device: str = option("auto", DEVICE_HELP, metavar="NAME")
    runtime: RuntimeName = option("auto", RUNTIME_HELP, metavar="NAME", section="matching")
    matching: MatchingOptions = field(default_factory=MatchingOptions)

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def is_network(self) -> bool:
        """Whether the matcher is one of our networks: it makes a dense map, and its features refine
        the matches and choose pairs."""
        return self._named is None

    @property
    def _named(self) -> NamedMatcher | None:
        """The row of a matcher other than our networks."""
        return next((row for row in MATCHERS if row.fits(self.weights)), None)

    @property
    def takes_second(self) -> bool:
        """Whether the matches of a second matcher can join those of this one."""
        return self.is_network and self.matching.aligned != "none"

    def load(self, cache: ImageCache | None = None, engine: Engine | None = None) -> Matcher:
        """The matcher; see `load_matcher`. engine: the engine of a network, if it is loaded."""
        name = self.weights
        named = self._named
        if named is not None:
            if not named.uses_device and self.device not in ("auto", "cpu"):
                only = f"must be auto or cpu for {name}, not {self.device}"
                raise InputError(ArgumentName("device"), only)
            return named.make(self, cache)
        try:
            engine = engine or load_engine(name, device=self.device, runtime=self.runtime)
        except WeightsError:
            if name in PRESETS or Path(name).suffix or Path(name).exists():
                raise
            names = ", ".join([*shipped(), *NAMES])
            missing = f"is neither a file nor a matcher; the matchers are {names}"
            raise InputError(Path(name), missing) from None
        return NetworkMatcher(engine, self.matching, cache)


def load_matcher(
    name: str | os.PathLike[str] = DEFAULT_WEIGHTS,
    *,
    device: str = "auto",
    runtime: RuntimeName = "auto",
    matching: MatchingOptions | None = None,
    cache: ImageCache | None = None,
) -> Matcher:
    """A matcher by its name; by default that of `dgc-pose estimate`.

    name: shipped weights ("dgcm-lite0"), a path to weights (see `load_network`), or one of `NAMES`.
    device: for the network. runtime: runs the network, see `load_engine`. matching: how matches are
    selected from a dense map and refined. cache: `ImageCache(bytes)` keeps what this matcher, and
    no other, computes from an image for the next pairs; None keeps it for the last three images,
    for a network some 35 MB each beside their pixels.

    Raises WeightsError if weights cannot be loaded, InputError if there is no such matcher or
    device.
    """
    check_type(name, str | os.PathLike, "name")
    check_type(cache, ImageCache | None, "cache")
    matching = MatchingOptions() if matching is None else matching
    return MatcherOptions(os.fspath(name), device, runtime, matching).load(cache)


def load_engine(
    weights: str | Path = DEFAULT_WEIGHTS, *, device: str = "auto", runtime: RuntimeName = "auto"
) -> Engine:
    """An engine for shipped weights, by name, or for the weights in a file (see `network.weights`).

    runtime: "onnx" runs presets that have graphs, on the CPU, and never imports torch; "torch" runs
    all weights; "auto" is `default_runtime`. Raises WeightsError if the weights cannot be loaded,
    InputError if there is no such device, or if the runtime is missing or cannot run the weights.
    """
    path = find_weights(weights)
    if runtime == "auto":
        runtime = default_runtime(weights, device)
    if runtime == "onnx":
        if device not in ("auto", "cpu"):
            raise InputError(ArgumentName("device"), f"must be cpu for ONNX Runtime, not {device}")
        from dgc_pose.runtime.onnx_engine import OnnxEngine

        return OnnxEngine(path)
    require({"the runtime torch" if path.suffix == SUFFIX else path.name: "torch"})
    from dgc_pose.runtime.torch_engine import TorchEngine

    return TorchEngine(load_network(path, choose_device(device)))


def default_runtime(weights: str | Path = DEFAULT_WEIGHTS, device: str = "auto") -> RuntimeName:
    """On the CPU, ONNX Runtime for `DEFAULT_WEIGHTS`, and for all our weights if torch is not
    installed; else torch. Raises as `find_weights`."""
    if find_weights(weights).suffix != SUFFIX or device not in ("auto", "cpu"):
        return "torch"
    if not is_installed("torch"):
        return "onnx"
    is_shipped = str(weights) == DEFAULT_WEIGHTS
    return "onnx" if is_shipped and device_type(device) == "cpu" else "torch"


def device_type(name: str) -> str:
    """The type of a device by its name, "cpu" or "cuda"; "auto" is a GPU if torch can use one.

    Imports torch only for a GPU by name, or if a GPU's driver is present. Raises InputError for an
    unknown name or a missing device.
    """
    if name == "cpu" or (name == "auto" and not (is_installed("torch") and _may_have_gpu())):
        return "cpu"
    require({f"device {name}": "torch"})
    return choose_device(name).type


def _may_have_gpu() -> bool:
    return shutil.which("nvidia-smi") is not None or any(Path(path).exists() for path in _DRIVERS)
