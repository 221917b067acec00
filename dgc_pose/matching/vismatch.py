"""The matchers of the package vismatch (image-matching-models), by their names there."""

import contextlib
import sys

import numpy as np

from dgc_pose.errors import InputError, reason
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import Matcher, MatchResult

PREFIX = "vismatch:"
ERROR_PX = 1.0  # pixels of the images; vismatch states none


class VismatchMatcher(Matcher):
    """A matcher of vismatch. Its weights, if it has any, are downloaded by vismatch.

    name: `vismatch:` and one of `vismatch.available_models`. Raises InputError if vismatch is not
    installed, has no such matcher, or cannot load it.
    """

    def __init__(self, name: str, device: str = "auto") -> None:
        self.name = name
        model = name.removeprefix(PREFIX)
        try:
            import torch
            import vismatch
        except (ImportError, RuntimeError) as error:  # e.g. torchvision built for another torch
            raise InputError(f"{name} needs `pip install vismatch` ({reason(error)})") from None
        if model not in vismatch.available_models:
            names = ", ".join(vismatch.available_models)
            raise InputError(f"{name}: vismatch has no {model}; choose one of {names}")
        if device == "auto":
            device = "cuda" if torch.cuda.is_available() else "cpu"
        try:
            with contextlib.redirect_stdout(sys.stderr):  # it prints what it downloads
                self._model = vismatch.get_matcher(model, device=device)
        except Exception as error:  # of any library that vismatch wraps
            raise InputError(f"{name} cannot be loaded: {reason(error)}") from error
        self._model.skip_ransac = True  # which would fit a homography

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        import torch

        planes1, planes2 = (
            torch.from_numpy(image.pixels.transpose(2, 0, 1) / np.float32(255))
            for image in (image1, image2)
        )
        try:
            with contextlib.redirect_stdout(sys.stderr):
                result = self._model(planes1, planes2)
        except Exception as error:
            raise InputError(f"{self.name} failed on the pair: {reason(error)}") from error
        points1 = result["matched_kpts0"]
        points2 = result["matched_kpts1"]
        confidence = result.get("matched_confidences")
        confidence = np.ones(len(points1)) if confidence is None else confidence.clip(0, 1)
        # Only detectors list the key points that they detected.
        detected = result.get("all_kpts0")
        key_points = detected is not None and len(detected) > 0
        return MatchResult(Matches(points1, points2, confidence, ERROR_PX, key_points), None)
