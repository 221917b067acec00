"""What a run trains and validates on, from the folders that users have."""

from collections.abc import Sequence
from pathlib import Path

import torch

from dgc_pose.errors import InputError
from dgc_pose.training.options import DEFAULT_SHARES, Shares
from dgc_pose.training.pairs import PairSource
from dgc_pose.training.photos import load_photos
from dgc_pose.training.posed_frames import read_scenes
from dgc_pose.training.posed_scenes import frame_pairs, load_posed

TRAINING = "training"
_PHOTOS, _ROOMS, _POSED = Shares(1, 0, 0, 0), Shares(0, 0, 1, 0), Shares(0, 0, 0, 1)


def load_data(
    photos: Path,
    light: Path | None = None,
    posed: Sequence[Path] = (),
    *,
    held: Sequence[str] = (),
    shares: Shares = DEFAULT_SHARES,
    device: torch.device | str = "cpu",
    depths: Path | None = None,
) -> dict[str, PairSource]:
    """What trains, by the name TRAINING, and what validates: photographs, rooms and, with scenes
    held back, posed photographs.

    photos, light: see `load_photos`; posed: folders for `read_scenes`; held: names of the
    scenes that validate; depths: see `load_posed`. Raises as these do, and InputError for a scene
    that is not there or if no frames make a pair.
    """
    training, held_back = load_photos(photos, light, device)
    sources = {
        TRAINING: PairSource(training, shares=shares),
        "photos": PairSource(held_back, shares=_PHOTOS),
        "rooms": PairSource(held_back, shares=_ROOMS),
    }
    frames = {name: scene for root in posed for name, scene in read_scenes(root).items()}
    if missing := sorted(set(held) - set(frames)):
        raise InputError(f"held: there is no scene {missing[0]}")
    if frames:
        scenes = load_posed(frames, device, depths)
        pairs = frame_pairs(scenes, frames.keys() - set(held))
        if pairs is None:
            raise InputError(f"posed: of {len(scenes.scene)} frames no two overlap as they should")
        sources[TRAINING] = PairSource(training, scenes, pairs, shares)
        validating = frame_pairs(scenes, held)
        if validating is not None:
            sources["posed"] = PairSource(held_back, scenes, validating, _POSED)
    return sources
