"""dgc-pose: the relative camera pose of two photographs by dense geometric correspondence.

>>> from dgc_pose import estimate_relative_pose
>>> pose = estimate_relative_pose("1.jpg", "2.jpg", K)  # doctest: +SKIP
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from dgc_pose.batch.judge import judge as judge
    from dgc_pose.cameras.calibration import pair_cameras as pair_cameras
    from dgc_pose.cameras.calibration import parse_camera as parse_camera
    from dgc_pose.cameras.camera import Camera as Camera
    from dgc_pose.errors import DgcPoseError as DgcPoseError
    from dgc_pose.errors import ImageError as ImageError
    from dgc_pose.errors import InputError as InputError
    from dgc_pose.errors import WeightsError as WeightsError
    from dgc_pose.estimation import EstimationOptions as EstimationOptions
    from dgc_pose.estimation import Hypothesis as Hypothesis
    from dgc_pose.estimation import RelativePose as RelativePose
    from dgc_pose.estimation import ScaleSource as ScaleSource
    from dgc_pose.estimation import estimate_pose as estimate_pose
    from dgc_pose.images.image import Image as Image
    from dgc_pose.images.image import load_image as load_image
    from dgc_pose.localization.locate import Locator as Locator
    from dgc_pose.localization.locate import locate as locate
    from dgc_pose.localization.location import Location as Location
    from dgc_pose.matchers import MatcherOptions as MatcherOptions
    from dgc_pose.matchers import load_matcher as load_matcher
    from dgc_pose.matches import Matches as Matches
    from dgc_pose.matching import CorrespondenceMap as CorrespondenceMap
    from dgc_pose.matching import Matcher as Matcher
    from dgc_pose.matching import MatchingOptions as MatchingOptions
    from dgc_pose.matching import MatchResult as MatchResult
    from dgc_pose.matching import NetworkMatcher as NetworkMatcher
    from dgc_pose.model import Model as Model
    from dgc_pose.model import load_model as load_model
    from dgc_pose.motion import CameraMotion as CameraMotion
    from dgc_pose.motion import FixedCamera as FixedCamera
    from dgc_pose.motion import camera_motion as camera_motion
    from dgc_pose.pose import PairResult as PairResult
    from dgc_pose.pose import estimate_relative_pose as estimate_relative_pose
    from dgc_pose.pose import solve_pair as solve_pair
    from dgc_pose.rigs.rig import Rig as Rig
    from dgc_pose.rigs.rig import estimate_rig as estimate_rig

# The public names of each module. Imported on first use, so that `dgc-pose --help` is quick.
_PUBLIC = {
    "batch.judge": ("judge",),
    "cameras.calibration": ("pair_cameras", "parse_camera"),
    "cameras.camera": ("Camera",),
    "errors": ("DgcPoseError", "ImageError", "InputError", "WeightsError"),
    "estimation": (
        "EstimationOptions",
        "Hypothesis",
        "RelativePose",
        "ScaleSource",
        "estimate_pose",
    ),
    "images.image": ("Image", "load_image"),
    "localization.locate": ("Locator", "locate"),
    "localization.location": ("Location",),
    "model": ("Model", "load_model"),
    "matchers": ("MatcherOptions", "load_matcher"),
    "matches": ("Matches",),
    "matching": (
        "CorrespondenceMap",
        "MatchResult",
        "Matcher",
        "MatchingOptions",
        "NetworkMatcher",
    ),
    "motion": ("CameraMotion", "FixedCamera", "camera_motion"),
    "pose": ("PairResult", "estimate_relative_pose", "solve_pair"),
    "rigs.rig": ("Rig", "estimate_rig"),
}
_HOMES = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("dgc_pose.version").version()
    if name in _HOMES:
        return getattr(importlib.import_module(f"dgc_pose.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'dgc_pose' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
