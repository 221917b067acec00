"""Fixed sets of synthetic pairs from photographs that training holds back.

The paper's sets (section 4 and Table 1) by their published ranges, without photometric changes and
occluders, as its lists have none; and ray-cast 3D scenes.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path

import torch

from dgc_pose.benchmarks.map_run import MapCase, MapSet
from dgc_pose.benchmarks.warps import FAR, Warp, affine_warp, homography_warp, spline_warp
from dgc_pose.errors import InputError
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.training.draw import Draw, other_light
from dgc_pose.training.pairs import occluded
from dgc_pose.training.photos import Photos, load_held_back
from dgc_pose.training.room_pairs import RoomOptions, room_pairs
from dgc_pose.training.views import MapPairs, pixel_grid

_Warps = Callable[[int, Draw], Warp]
# By number, the warps of a batch's pairs in turn.
_WARPS: dict[str, tuple[_Warps, ...]] = {
    "affine": (affine_warp,),
    "affine-tps": (affine_warp, spline_warp),
    "homography": (homography_warp,),
}
_SCENES = "scenes"  # ray-cast
SETS = (*_WARPS, _SCENES)

# The paper's views are the middle 9/16 of a photograph's width and height, mirrored beyond its
# edges. Ours have any position.
_VIEW = 9 / 16
PHOTO_SIDE = round(INPUT_SIZE / _VIEW / 16) * 16  # pixels: a view is not enlarged once more
_OCCLUDED = 0.3  # of the views, if they are changed
ROTATION_DEG = (5.0, 30.0)  # between the cameras of a scene, roll included
_BATCH = 8  # pairs made at a time; another number would make other pairs


def synthetic_set(
    root: str | Path, names: Sequence[str], pairs: int, seed: int, *, changed: bool = False
) -> MapSet:
    """`pairs` pairs of each set named, from the photographs below `root` that training holds back.

    Raises InputError for a name that is none of SETS or for no names, ImageError if no photograph
    is held back.
    """
    for name in names:
        if name not in SETS:
            raise InputError(f"no set '{name}'; there are {', '.join(SETS)}")
    if not names:
        raise InputError("no sets named")
    photos = load_held_back(Path(root), PHOTO_SIDE)
    names = list(dict.fromkeys(names))
    cases = (synthetic_cases(photos, name, pairs, seed, changed=changed) for name in names)
    facts = {"photographs": photos.single, "seed": seed, "changed": changed}
    light = "with changes of light and occluders" if changed else "light as it is, no occluders"
    title = f"{photos.single} photographs that training holds back, seed {seed}, {light}"
    total = pairs * len(names)
    return MapSet(chain.from_iterable(cases), total, facts, title)


def synthetic_cases(
    photos: Photos, name: str, pairs: int, seed: int, *, changed: bool = False
) -> Iterator[MapCase]:
    """Batches of the set of that name, always the same for the same photographs and seed.

    changed: with the trainer's photometric changes, and its occluders in warped views.
    """
    make = partial(_scenes, photos) if name == _SCENES else partial(_warped, photos, _WARPS[name])
    done = number = 0
    while done < pairs:
        draw = Draw(photos.bank.texels.device, "synthetic", name, seed, number)
        batch, number = make(draw, changed), number + 1
        if changed:
            views = other_light(torch.cat([batch.image1, batch.image2]), draw)
            image1, image2 = views.chunk(2)
            batch = batch._replace(image1=image1, image2=image2)
        chosen = MapPairs(*(values[: pairs - done] for values in batch))
        # The target may show the plane's horizon, which no real view does.
        horizons = (chosen.map >= FAR).flatten(1).any(1).tolist()
        names = [f"{name} {done + k}" + ", past its horizon" * h for k, h in enumerate(horizons)]
        yield MapCase(name, tuple(names), chosen)
        done += len(names)


def _warped(photos: Photos, warps: tuple[_Warps, ...], draw: Draw, changed: bool) -> MapPairs:
    """A batch, with occluders if it is to be changed. Its light is that of the photographs."""
    chosen = draw.integers(_BATCH, count=photos.single)
    size = photos.bank.size(chosen)
    pixels = pixel_grid((INPUT_SIZE, INPUT_SIZE), draw.device).expand(_BATCH, -1, -1, -1)
    grid = ((2 * pixels + 1) / INPUT_SIZE - 1).flatten(1, 2)
    kinds = [warp(_BATCH, draw)(grid)[k :: len(warps)] for k, warp in enumerate(warps)]
    source = torch.stack(kinds, 1).flatten(0, 1).view_as(pixels)
    side = _VIEW * size.amin(1)[:, None]
    corner = -0.5 + (size - side) * draw.uniform(_BATCH, 2)

    def view(points: torch.Tensor) -> torch.Tensor:
        place = corner[:, None, None] + side[:, None, None] * (points + 1) / 2
        return photos.bank.sample(chosen[:, None, None], place, side[:, None] / INPUT_SIZE)

    image1, hidden1 = occluded(photos, view(grid.view_as(pixels)), draw, _OCCLUDED * changed)
    image2, hidden2 = occluded(photos, view(source), draw, _OCCLUDED * changed)
    behind = torch.nn.functional.grid_sample(
        hidden1.float()[:, None], source, mode="nearest", align_corners=False
    )
    valid = (source.abs() <= 1).all(-1) & (behind[:, 0] < 0.5) & ~hidden2
    truth = ((source + 1) * INPUT_SIZE - 1) / 2
    known = torch.ones_like(valid)
    return MapPairs(image1.movedim(-1, 1), image2.movedim(-1, 1), truth, valid, known)


def _scenes(photos: Photos, draw: Draw, changed: bool) -> MapPairs:
    """Those of a batch of rooms whose cameras differ by ROTATION_DEG."""
    options = RoomOptions(orbit_deg=ROTATION_DEG)
    views = room_pairs(photos, _BATCH, (INPUT_SIZE, INPUT_SIZE), draw, options)
    R = views.target.seen_by(views.source).pose[..., :3]
    cosine = (R.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2
    angle = torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))
    which = (angle >= ROTATION_DEG[0]) & (angle <= ROTATION_DEG[1])
    return MapPairs(*(values[which] for values in views.maps))
