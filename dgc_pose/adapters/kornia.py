"""A matcher with the call of kornia's `LoFTR`."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from dgc_pose.errors import InputError
from dgc_pose.images.image import load_image
from dgc_pose.matchers import load_matcher
from dgc_pose.matching.matcher import Matcher


class LoFTRShape(nn.Module):
    """Takes `kornia.feature.LoFTR`'s place: the same input and output.

    >>> output = LoFTRShape()({"image0": grey0, "image1": grey1})  # doctest: +SKIP
    >>> output["keypoints0"], output["keypoints1"], output["confidence"]  # doctest: +SKIP
    """

    def __init__(self, matcher: Matcher | None = None) -> None:
        """matcher: by default `load_matcher()`, the shipped network with refinement."""
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
        matches = []
        for i, (image0, image1) in enumerate(zip(images0, images1, strict=True)):
            # Clamped: resampling may leave values outside, and `load_image` would rescale them all.
            tensors = {f"image0[{i}]": image0, f"image1[{i}]": image1}
            images = (
                load_image(tensor.float().clamp(0, 1), name) for name, tensor in tensors.items()
            )
            matches.append(self.matcher.match(*images).matches)
        points0, points1, confidence = (
            torch.from_numpy(np.concatenate([getattr(of_pair, field) for of_pair in matches]))
            for field in ("points1", "points2", "confidence")
        )
        index = np.repeat(np.arange(len(matches)), [len(of_pair) for of_pair in matches])
        return {
            "keypoints0": points0.to(images0),
            "keypoints1": points1.to(images0),
            "confidence": confidence.to(images0),
            "batch_indexes": torch.from_numpy(index).to(images0.device),
        }
