"""Batches of random pairs of all kinds, made on the device of the network."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from dgc_pose.errors import InputError
from dgc_pose.training.draw import Draw
from dgc_pose.training.light import other_light
from dgc_pose.training.map_pairs import MapPairs, joined
from dgc_pose.training.options import DEFAULT_SHARES, Shares
from dgc_pose.training.photos import Photos
from dgc_pose.training.posed_pairs import posed_pairs
from dgc_pose.training.posed_scenes import FramePairs, PosedScenes
from dgc_pose.training.room_pairs import room_pairs
from dgc_pose.training.views import Shape
from dgc_pose.training.warped_pairs import warped_pairs

_OFFSETS = range(1000)


@dataclass(frozen=True)
class PairSource:
    """What pairs are made of, on the device of the network."""

    photos: Photos
    scenes: PosedScenes | None = None
    frames: FramePairs | None = None  # of the scenes
    shares: Shares = DEFAULT_SHARES

    def make(self, count: int, shape: Shape, draw: Draw) -> MapPairs:
        """So many pairs of views of `shape`, in light of their own, one kind after the other.

        Raises InputError if the shares leave no kind that there is data for.
        """
        kinds = {
            "photos": self.shares.photos,
            "light": self.shares.light if len(self.photos.places) else 0.0,
            "rooms": self.shares.rooms,
            "posed": self.shares.posed if self.frames is not None else 0.0,
        }
        total = sum(kinds.values())
        if not total:
            raise InputError("shares: there is no data for the kinds of pairs that have a share")
        offset = draw.choice(_OFFSETS) / len(_OFFSETS)  # so that small batches have all kinds, too
        parts, before = [], 0.0
        for kind, share in kinds.items():
            after = before + count * share / total
            number = round_up(after, offset) - round_up(before, offset)
            before = after
            if not number:
                continue
            if kind == "rooms":
                parts.append(room_pairs(self.photos, number, shape, draw).maps)
            elif kind == "posed":
                assert self.scenes is not None and self.frames is not None
                parts.append(posed_pairs(self.scenes, self.frames, number, shape, draw))
            else:
                parts.append(warped_pairs(self.photos, number, shape, draw, light=kind == "light"))
        pairs = joined(parts)
        views = other_light(torch.cat([pairs.image1, pairs.image2]), draw)
        image1, image2 = views.chunk(2)
        return replace(pairs, image1=image1, image2=image2, valid=pairs.valid & pairs.known)


def round_up(place: float, offset: float) -> int:
    """How many of the places offset, 1 + offset, ... lie below `place`, to its rounding."""
    return max(0, -int((offset - place + 1e-9) // 1))
