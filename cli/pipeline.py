"""The steps that `estimate` and `demo` share."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from dgc_pose.camera import Camera
from dgc_pose.cli.options import MatcherChoice
from dgc_pose.estimation import EstimationOptions
from dgc_pose.image import Image, load_image

if TYPE_CHECKING:
    from dgc_pose.pose import Trace

NO_POSE = 3  # exit code where there is no pose


def run_pipeline(
    path1: str | Path,
    path2: str | Path,
    resolve: Callable[[Image, Image], tuple[Camera, Camera]],
    network: MatcherChoice,
    estimation: EstimationOptions,
) -> Trace:
    """Read both images, find their cameras by `resolve`, load the network, estimate the pose.

    `seconds` of the pose counts the images and the weights as `load`.
    """
    start = time.perf_counter()
    image1, image2 = load_image(path1), load_image(path2)
    camera1, camera2 = resolve(image1, image2)
    read = time.perf_counter() - start
    from dgc_pose.pose import trace_relative_pose  # torch, which images of no use need not wait for

    start = time.perf_counter()
    matcher = network.load()
    load = read + time.perf_counter() - start
    trace = trace_relative_pose(
        image1, image2, camera1, camera2, matcher=matcher, options=estimation
    )
    pose = replace(trace.pose, seconds={**trace.pose.seconds, "load": load})
    return replace(trace, pose=pose)


def draw(trace: Trace, file: Path, name: str) -> None:
    """Draw what the pose was estimated from into a file, in the format that `name` ends in."""
    from dgc_pose.viz import plot_pose, save_figure
    from dgc_pose.viz.figure import picture_format

    save_figure(plot_pose(trace), file, picture_format=picture_format(name))


def check_picture(name: str | None) -> None:
    """Refuse, with an InputError, a picture in a format that cannot be drawn, before the work."""
    if name is not None:
        from dgc_pose.viz.figure import picture_format

        picture_format(name)
