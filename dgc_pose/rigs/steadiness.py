"""Whether the frames of a fixed camera show it in one position."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.images.image import Image, resize_by
from dgc_pose.matches import Matches
from dgc_pose.matching.key_points import SiftMatcher

_SIDE = 400.0  # longer side of the frames that are compared, pixels
_MOVED = 1e-3  # share of the longer side: about 0.05 degrees, from which a camera has moved
_INLIER = 1.0  # largest error of a match, pixels of the compared frames
_STAYS = 0.15  # share of the matches that stay against a motion: it is an object's
_AGREE = 0.5  # least share of matches that agree with a motion
_LEAST = 20  # least number


def steady_frames(frames: Mapping[Path, Image]) -> tuple[dict[Path, Image], str]:
    """The frames in the position that most frames have, and a sentence if others are left out.

    A frame whose position is unknown is kept. frames: of one size. Raises InputError, with the
    largest motion of the picture, if no position has more than half of the frames.
    """
    paths = [*frames]
    moves = _motions([*frames.values()])
    is_known = np.isfinite(moves).all((1, 2))
    apart = np.linalg.norm(moves[:, None] - moves, axis=3).max(2)  # (N, N); NaN if unknown
    agree = apart <= _MOVED
    best = int(np.argmax(agree.sum(1)))
    left_out = np.flatnonzero(is_known & ~agree[best])
    if not len(left_out):
        return dict(frames), ""
    farthest = int(np.nanargmax(np.where(is_known, apart[best], np.nan)))
    between = f"{paths[best]} and {paths[farthest].name}"
    observed = f"the picture moves by {100 * apart[best, farthest]:.2g} % of its side between"
    kept = len(frames) - len(left_out)
    if 2 * int(agree[best].sum()) <= int(is_known.sum()):
        none = f"no position has most of the {len(frames)} frames"
        raise InputError(f"{observed} {between}, and {none}")
    line = f"{observed} {between}: the {kept} of {len(frames)} frames in one position are used"
    return {path: frames[path] for n, path in enumerate(paths) if n not in left_out}, line


def _motions(frames: list[Image]) -> np.ndarray:
    """The motion of each picture since the first, at the middles of its quarters, as a share of the
    longer side: (N, 4, 2); NaN where too few matches agree on one."""
    matcher = SiftMatcher()
    scale = min(1.0, _SIDE / max(frames[0].size))
    small = [Image(resize_by(frame.pixels, scale)) for frame in frames]
    width, height = small[0].size
    places = np.array([[x * width, y * height] for x in (0.25, 0.75) for y in (0.25, 0.75)])
    moves = np.full((len(frames), 4, 2), np.nan)
    moves[0] = 0
    for number, frame in enumerate(small[1:], start=1):
        matches = matcher.match(small[0], frame).matches
        if len(matches) < _LEAST:
            continue
        stays = np.linalg.norm(matches.points2 - matches.points1, axis=1) < _INLIER
        similarity, agrees = _similarity(matches)
        if similarity is not None and (stays & ~agrees).mean() > _STAYS:
            similarity, agrees = _similarity(matches.subset(stays))
        elif agrees.sum() < max(_LEAST, _AGREE * len(matches)):
            continue
        if similarity is None:
            continue
        moved = places @ similarity[:, :2].T + similarity[:, 2]
        moves[number] = (moved - places) / max(width, height)
    return moves


def _similarity(matches: Matches) -> tuple[np.ndarray | None, np.ndarray]:
    """The motion (2, 3) that most matches agree with, and which do (N,); None without one."""
    found, agrees = cv2.estimateAffinePartial2D(
        matches.points1, matches.points2, ransacReprojThreshold=_INLIER
    )
    return found, np.ravel(agrees).astype(bool)
