"""A matcher as a class of vismatch (image-matching-models)."""

from typing import Any

import numpy as np
from vismatch import BaseMatcher

from dgc_pose.images.image import load_image
from dgc_pose.matchers import load_matcher
from dgc_pose.matching.matcher import Matcher


class DgcPoseMatcher(BaseMatcher):  # type: ignore[misc, unused-ignore]
    """vismatch's interface: `matcher(img0, img1)` gives its dictionary of matches and inliers.

    >>> result = DgcPoseMatcher()("1.jpg", "2.jpg")  # doctest: +SKIP
    """

    def __init__(self, device: str = "cpu", matcher: Matcher | None = None, **kwargs: Any) -> None:
        """device: of the network, "cpu" or "cuda". matcher: by default
        `load_matcher(device=device)`, the shipped network with refinement. kwargs: of vismatch's
        `BaseMatcher`, such as its options of RANSAC."""
        super().__init__(device, **kwargs)
        self.matcher = matcher or load_matcher(device=device)

    def _forward(self, img0: Any, img1: Any) -> tuple[np.ndarray | None, ...]:
        """Matches of two tensors (3, H, W) in [0, 1], pixels of the images; no key points beside
        them, and no descriptors."""
        # Clamped: resampling may leave values slightly outside, and `load_image` would rescale all.
        tensors = {"img0": img0.float().clamp(0, 1), "img1": img1.float().clamp(0, 1)}
        images = (load_image(tensor, name) for name, tensor in tensors.items())
        matches = self.matcher.match(*images).matches
        return matches.points1, matches.points2, None, None, None, None, matches.confidence
