"""Whether a query is a picture of the place: a print, a screen or a painting, seen at a slant.

A photograph of a photograph is an image by a projective camera, whose centre is that of the first
photograph (Hartley and Zisserman 2004, section 6.2.4). The slant squeezes the picture in some
direction, so the camera has a skew or pixels that are not square, and moves the principal point
far from the middle; Wang and Farid (2008) recognise films of a screen by the skew. A picture seen
from its front is a photograph scaled and moved: nothing shows it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.cameras.camera import Camera, image_size
from dgc_pose.estimation.camera_changes import has_sensor_shape
from dgc_pose.estimation.intrinsics_prior import SIZE, IntrinsicsPrior, with_parameters
from dgc_pose.localization.correspondences import Correspondences, WorldPose
from dgc_pose.localization.fit import even_sample, fitted, score, world_covariance

# Deviations of the projective camera: of ln f and ln fy / fx, and of the principal point over the
# longer side.
_LOG_STD = 0.5
_CENTRE_STD = 0.4
# Least squeeze, which is ln fy / fx and the skew together, and least distance of the principal
# point, over the longer side, from where it is expected.
_SQUEEZE = 0.015
_SHIFT = 0.04
# Least skew with the principal point that far off, and with another: a shutter that reads line by
# line skews what a camera sees that turns.
_SKEW = 0.01
_SKEW_OF_SHUTTER = 0.03
_STDS = 3.0  # by which each of them differs from 0
_SAMPLED = 400  # matches of a pair
_EXPLAINED = 0.4  # least score of a match on average, see `score`
# Thresholds of the fits, one after the other, over that of an inlier: the pose of a camera explains
# only a part of the matches.
_WIDENED = (16.0, 4.0, 1.0)


def picture_text(
    every: Sequence[Correspondences],
    pose: WorldPose,
    database: Camera,
    camera: Camera,
    stated: Camera,
) -> str:
    """What shows that the query is a picture of the place; "" for a query that a camera took there.

    pose: with the camera, which normalised the correspondences. database: of an image of the model.
    stated: the query's camera, as stated or assumed.
    """
    size = np.array(image_size(camera))
    wide = replace(
        camera,
        focal_std=_LOG_STD,
        centre_std=_CENTRE_STD * float(size.max()),
        aspect_std=_LOG_STD,
    )
    prior = IntrinsicsPrior.of(database, wide)
    some = [part.subset(even_sample(len(part), _SAMPLED)) for part in every]
    for factor in _WIDENED:
        pose = fitted([part.widened(factor) for part in some], pose, prior, skewed=True)
    covariance = world_covariance(some, pose, prior, skewed=True)
    if covariance is None or score(some, pose) < _EXPLAINED * sum(map(len, some)):
        return ""
    stds = np.sqrt(prior.covariance(covariance[6:-1, 6:-1]).diagonal()[SIZE:])
    skew_std = math.sqrt(covariance[-1, -1])
    K = with_parameters(camera, pose.parameters).K
    ratio = K[1, 1] / K[0, 0]
    skew = pose.skew / ratio
    squeeze = math.hypot(math.log(ratio * stated.K[0, 0] / stated.K[1, 1]), skew)
    shift = float(np.abs(K[:2, 2] - stated.K[:2, 2]).max() / size.max())
    shift_std = float(stds[1:3].max()) * camera.focal / float(size.max())
    is_shifted = shift > max(_SHIFT, _STDS * shift_std)
    is_skewed = abs(skew) > max(_SKEW if is_shifted else _SKEW_OF_SHUTTER, _STDS * skew_std)
    is_squeezed = squeeze > max(_SQUEEZE, _STDS * max(float(stds[5]), skew_std))
    # A picture may be squeezed along a side and cut, but then has hardly the shape of a sensor.
    if not (is_skewed or (is_squeezed and is_shifted and has_sensor_shape(camera))):
        return ""
    x, y = K[:2, 2].tolist()
    width, height = size.round().tolist()
    return (
        f"most matches agree with fy / fx {ratio:.3f}, skew {skew:.3f} and the principal point "
        f"({x:.0f}, {y:.0f}) in {width:.0f}x{height:.0f} pixels, which no camera has"
    )
