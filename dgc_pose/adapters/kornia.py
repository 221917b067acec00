"""A matcher with the call of kornia's `LoFTR`."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from dgc_pose.adapters.images import image_of_tensor
from dgc_pose.errors import InputError
from dgc_pose.matchers import load_matcher
from dgc_pose.matching.matcher import Matcher


class LoFTRShape(nn.Module):
    """Takes `kornia.feature.LoFTR`'s place: the same input and output.

    >>> matcher = LoFTRShape()  # doctest: +SKIP
    >>> found = matcher({"image0": grey0, "image1": grey1})  # doctest: +SKIP
    >>> found["keypoints0"], found["keypoints1"], found["confidence"]  # doctest: +SKIP
    """

    def __init__(self, matcher: Matcher | None = None) -> None:
        """
        Args:
            matcher: by default `load_matcher()`, the shipped network with refinement.
        """
        super().__init__()
        self.matcher = matcher or load_matcher()

    def forward(self, data: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Matches of a batch of pairs.

        data: `image0` (N, 1 or 3, H, W) and `image1`, values in [0, 1]; the sizes may differ.

        Returns `keypoints0`, `keypoints1` (M, 2) in pixels of the images, (0, 0) the centre of the
        first pixel, `confidence` (M,) and `batch_indexes` (M,), on the images' device.

        Raises InputError for other shapes.
        """
        images0, images1 = data["image0"], data["image1"]
        if images0.ndim != 4 or images1.ndim != 4 or len(images0) != len(images1):
            raise InputError(
                f"image0 and image1 must be batches (N, C, H, W) of one length, not "
                f"{tuple(images0.shape)} and {tuple(images1.shape)}"
            )
        points0, points1, confidence, index = [], [], [], []
        for i, pair in enumerate(zip(images0, images1, strict=True)):
            names = (f"image0[{i}]", f"image1[{i}]")
            made = [image_of_tensor(one, name) for one, name in zip(pair, names, strict=True)]
            matches = self.matcher.match(*made).matches
            points0.append(torch.from_numpy(matches.points1))
            points1.append(torch.from_numpy(matches.points2))
            confidence.append(torch.from_numpy(matches.confidence))
            index.append(torch.full((len(matches),), i, dtype=torch.long))
        return {
            "keypoints0": torch.cat(points0).to(images0),
            "keypoints1": torch.cat(points1).to(images0),
            "confidence": torch.cat(confidence).to(images0),
            "batch_indexes": torch.cat(index).to(images0.device),
        }
