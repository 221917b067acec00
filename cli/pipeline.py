"""The steps that `estimate` and `demo` share."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import Image, load_image
from dgc_pose.matchers import MatcherOptions

if TYPE_CHECKING:
    from dgc_pose.pose import Trace

NO_POSE = 3  # exit code if there is no pose


def run_pipeline(
    path1: str | Path,
    path2: str | Path,
    resolve: Callable[[Image, Image], tuple[Camera, Camera]],
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> Trace:
    """Read both images, get their cameras from `resolve`, load the matcher, estimate the pose.

    resolve: raises InputError if a camera does not fit its image. In `seconds` of the pose, `load`
    is the time for images and weights.
    """
    start = time.perf_counter()
    image1, image2 = load_image(path1), load_image(path2)
    camera1, camera2 = resolve(image1, image2)
    read_seconds = time.perf_counter() - start
    from dgc_pose.pose import match_and_estimate  # heavy; unusable input is refused without it

    start = time.perf_counter()
    loaded = matcher.load()
    load_seconds = read_seconds + time.perf_counter() - start
    return match_and_estimate(image1, image2, camera1, camera2, loaded, estimation, load_seconds)


def draw(trace: Trace, stage: Callable[[str], Path], name: str | None) -> None:
    """Draw the trace of a pose into the staged output `name`, unless that is None."""
    if name is None:
        return
    from dgc_pose.viz import plot_pose, save_figure

    save_figure(plot_pose(trace), stage(name))


def check_picture(name: str | None) -> None:
    """Raise InputError, before the work, if `name` ends in no format that can be drawn."""
    if name is not None:
        from dgc_pose.viz.figure import picture_format

        picture_format(name)
