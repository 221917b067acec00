"""Distillation: a larger network's map as a further target, and as the truth if none is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch

from dgc_pose.errors import InputError
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.net import DGCNet
from dgc_pose.network.statistics import normalise
from dgc_pose.network.weights import load_network
from dgc_pose.synthesis.map_pairs import MapPairs
from dgc_pose.training.stages import TeacherTarget


class Teacher:
    """A trained network with a mask; pixels of matchability above one half are its targets."""

    def __init__(self, net: DGCNet, weight: float) -> None:
        self.net = net.eval().requires_grad_(False)
        self.weight = weight
        if net.config.matchability is None:
            raise InputError(f"{net.config.name} has no matchability, which a teacher needs")

    @classmethod
    def load(
        cls, weights: str | Path, weight: float, device: torch.device, half_precision: bool
    ) -> Teacher:
        """Raises WeightsError if the file is unusable, InputError for a network without a mask."""
        net = load_network(weights, device)
        net.half_precision = half_precision
        return cls(net.to(memory_format=torch.channels_last), weight)  # type: ignore[call-overload]

    @torch.no_grad()
    def target(self, pairs: MapPairs) -> tuple[MapPairs, TeacherTarget]:
        """The pairs, with the teacher's map as the truth where none is known; and its target."""
        source, target = (
            normalise(image).contiguous(memory_format=torch.channels_last)
            for image in (pairs.image1, pairs.image2)
        )
        prediction = self.net(source, target)
        found = prediction.maps[-1].movedim(1, -1)
        found = to_pixels(found, (INPUT_SIZE,) * 2, self.net.config.align_corners)
        confident = prediction.logits[-1][:, 0] > 0
        completed = replace(
            pairs,
            map=torch.where(pairs.known[..., None], pairs.map, found),
            valid=torch.where(pairs.known, pairs.valid, confident),
            known=torch.ones_like(pairs.known),
        )
        return completed, TeacherTarget(found, confident, self.weight)
