"""Batches of random pairs of all kinds, made on the device of the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from dgc_pose.errors import InputError
from dgc_pose.training.draw import Draw
from dgc_pose.training.light import other_light
from dgc_pose.training.map_pairs import MapPairs
from dgc_pose.training.options import Shares
from dgc_pose.training.photos import Photos, load_photos
from dgc_pose.training.posed_frames import PosedFrame, read_scenes
from dgc_pose.training.posed_pairs import FramePairs, frame_pairs, load_posed, posed_pairs
from dgc_pose.training.room_pairs import room_pairs
from dgc_pose.training.views import Shape
from dgc_pose.training.warped_pairs import warped_pairs

TRAINING = "training"  # what trains; all else validates
_OFFSETS = range(1000)


@dataclass(frozen=True)
class PairSource:
    """What pairs are made of, on the device of the network."""

    photos: Photos
    posed: FramePairs | None = None
    shares: Shares = Shares()

    def make(self, count: int, shape: Shape, draw: Draw) -> MapPairs:
        """So many pairs of views of `shape`, in light of their own, one kind after the other.

        Raises InputError if the shares leave no kind that there is data for.
        """
        photos, posed = self.photos, self.posed
        there = True, len(photos.places) > 0, True, posed is not None
        ends = np.cumsum(np.multiply(self.shares, there))
        if not ends[-1]:
            raise InputError("shares: there is no data for the kinds of pairs that have a share")
        # Evenly from a random start, so that small batches have all kinds, too.
        places = (np.arange(count) + draw.choice(_OFFSETS) / len(_OFFSETS)) * ends[-1] / count
        kinds = ends.searchsorted(places, "right")
        warped, relit, rooms, cut = np.bincount(kinds, minlength=4).tolist()
        parts = []
        if warped:
            parts.append(warped_pairs(photos, warped, shape, draw, light=False))
        if relit:
            parts.append(warped_pairs(photos, relit, shape, draw, light=True))
        if rooms:
            parts.append(room_pairs(photos, rooms, shape, draw).maps)
        if cut and posed is not None:
            parts.append(posed_pairs(posed, cut, shape, draw))
        image1, image2, truth, valid, known = map(torch.cat, zip(*parts, strict=True))
        image1, image2 = other_light(torch.cat([image1, image2]), draw).chunk(2)
        return MapPairs(image1, image2, truth, valid & known, known)


def load_data(
    photos: Path,
    light: Path | None = None,
    posed: Sequence[Path] = (),
    *,
    depths: Path,
    held: Sequence[str] = (),
    shares: Shares,
    device: torch.device | str = "cpu",
) -> dict[str, PairSource]:
    """What trains, by the name TRAINING, and what validates: photographs, rooms and, with scenes
    held back, posed photographs.

    photos, light: see `load_photos`; posed: folders for `read_scenes`; depths: see `load_posed`;
    held: names of the scenes that validate. Raises as these and `frame_pairs` do; InputError for a
    scene that is not there or there twice.
    """
    frames: dict[str, list[PosedFrame]] = {}
    for root in posed:
        found = read_scenes(root)
        if twice := sorted(frames.keys() & found):
            raise InputError(f"posed: {root}: another folder, too, has a scene {twice[0]}")
        frames |= found
    if missing := sorted(set(held) - set(frames)):
        raise InputError(f"held: there is no scene {missing[0]}")
    trains = [name for name in frames if name not in held] if shares.posed else []
    if frames and shares.posed and not trains:
        raise InputError("held: no scene of posed is left to train")
    needed = {name: scene for name, scene in frames.items() if name in held or name in trains}
    training, held_back = load_photos(photos, light, device)
    pairs = validating = None
    if needed:
        scenes = load_posed(needed, device, depths)
        pairs = frame_pairs(scenes, trains) if trains else None
        validating = frame_pairs(scenes, held) if held else None
    sources = {
        TRAINING: PairSource(training, pairs, shares),
        "photos": PairSource(held_back, shares=Shares(1, 0, 0, 0)),
        "rooms": PairSource(held_back, shares=Shares(0, 0, 1, 0)),
    }
    if validating is not None:
        sources["posed"] = PairSource(held_back, validating, Shares(0, 0, 0, 1))
    return sources
