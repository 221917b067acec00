"""dgc-pose: the relative camera pose of two photographs by dense geometric correspondence.

>>> from dgc_pose import estimate_relative_pose
>>> pose = estimate_relative_pose("1.jpg", "2.jpg", K)  # doctest: +SKIP
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from dgc_pose.cameras.calibration import parse_camera
    from dgc_pose.cameras.camera import Camera
    from dgc_pose.errors import DgcPoseError, ImageError, InputError, WeightsError
    from dgc_pose.estimation import (
        EstimationOptions,
        Hypothesis,
        RelativePose,
        estimate_pose,
    )
    from dgc_pose.images.image import Image, load_image
    from dgc_pose.matchers import MatcherCaches, MatcherOptions, load_matcher
    from dgc_pose.matches import Matches
    from dgc_pose.matching import (
        CorrespondenceMap,
        DenseMatcher,
        Matcher,
        MatchingOptions,
        MatchResult,
        PairSearch,
        load_dense_matcher,
    )
    from dgc_pose.pose import estimate_relative_pose
    from dgc_pose.refinement import RefinementOptions, Refiner
    from dgc_pose.trace import Trace

# The public names of each module. Imported on first use, so that `dgc-pose --help` is quick.
_PUBLIC = {
    "cameras.calibration": ("parse_camera",),
    "cameras.camera": ("Camera",),
    "errors": ("DgcPoseError", "ImageError", "InputError", "WeightsError"),
    "estimation": (
        "EstimationOptions",
        "Hypothesis",
        "RelativePose",
        "estimate_pose",
    ),
    "images.image": ("Image", "load_image"),
    "matchers": ("MatcherCaches", "MatcherOptions", "load_matcher"),
    "matches": ("Matches",),
    "matching": (
        "CorrespondenceMap",
        "DenseMatcher",
        "MatchResult",
        "Matcher",
        "MatchingOptions",
        "PairSearch",
        "load_dense_matcher",
    ),
    "refinement": ("RefinementOptions", "Refiner"),
    "pose": ("estimate_relative_pose",),
    "trace": ("Trace",),
}
_HOMES = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = [
    "Camera",
    "CorrespondenceMap",
    "DenseMatcher",
    "DgcPoseError",
    "EstimationOptions",
    "Hypothesis",
    "Image",
    "ImageError",
    "InputError",
    "MatchResult",
    "Matcher",
    "MatcherCaches",
    "MatcherOptions",
    "Matches",
    "MatchingOptions",
    "PairSearch",
    "RefinementOptions",
    "Refiner",
    "RelativePose",
    "Trace",
    "WeightsError",
    "estimate_pose",
    "estimate_relative_pose",
    "load_dense_matcher",
    "load_image",
    "load_matcher",
    "parse_camera",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("dgc_pose.version").version()
    if name in _HOMES:
        return getattr(importlib.import_module(f"dgc_pose.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'dgc_pose' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
