"""The cameras of a folder: which photographs share one, and what all of their pairs say of it.

Photographs of one `identity` share a camera, as long as their pairs agree with it. A photograph
whose pairs do not, and one that is alone of its identity, has a camera of its own, which is fitted
to its pairs with photographs of known cameras: one more unknown camera is determined there far
better than two are. If this agrees with the camera of a group, at the scale of its size, the
photograph has that camera after all.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.batch.pooling import (
    FittedPair,
    PooledCamera,
    centre_moved,
    pool,
    sharing,
)
from dgc_pose.batch.poses import Poses, fitted_pairs
from dgc_pose.batch.rows import PairRow
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import SHARED, SIZE_STD
from dgc_pose.estimation.camera_model import with_model
from dgc_pose.estimation.evidence import ModelName
from dgc_pose.geometry.pixels import same_shape

Cameras = Mapping[str, Camera]  # by image name, with the image's size
_MIN_GROUP = 3  # images of a camera that one of them can be told from
_MIN_INLIERS = 50  # of a pair that ought to determine its cameras
_AGREEING_SHARE = 0.5  # of these pairs; a photograph with fewer that agree is looked at by itself
_AGREEING_STDS, _SAME_STDS = 3.0, 2.0  # of ln f: of a pair and its group; of two cameras
_SAME_FOCAL = 0.01  # difference of ln f of one camera, by its focus
_TELLING_FOCAL_STD = 0.1  # of ln f, above which a fit agrees with any camera
_PARTNER_FOCAL_STD = 0.15  # of ln f, up to which a camera helps to determine another
_CENTRE_OF_PART = 0.1  # deviation of the principal point of a photograph that may be cut
_AS_MANY = 0.97  # of the inliers of a free fit, that those of a squeezed camera are
_MOST_PAIRS = 6  # that a camera of its own is fitted to, those of the most inliers


def folder_cameras(poses: Poses, cameras: Cameras) -> tuple[dict[str, Camera], list[PooledCamera]]:
    """The cameras by image name, and one by one those that had a deviation.

    poses: of pairs that are stored each with its own fit of `cameras`.
    """
    pairs = fitted_pairs(poses.store.blocks())
    start = _by_models(cameras, pairs)
    pooled, _ = pool(start, _within(pairs, sharing(start)))
    if start != cameras or centre_moved(start, pooled):
        start = {name: replace(c, K=pooled[name].K) for name, c in start.items()}
        pairs = fitted_pairs(poses.estimated(start, fit=True))
    groups = sharing(start)
    known, _ = pool(start, _within(pairs, groups))
    single = {name for name, names in groups.items() if len(names) == 1}
    certain = [n for n, c in known.items() if n not in single and c.focal_std < _PARTNER_FOCAL_STD]
    doubted = {}  # whether no pair at all agrees with the camera of the group
    for name in certain:
        if start[name].focal_source != "given" and start[name].identity != SHARED:
            agreeing, count = _agreement(name, groups[name], known, pairs)
            if len(groups[name]) >= _MIN_GROUP and agreeing < _AGREEING_SHARE * count:
                doubted[name] = agreeing == 0
    own: dict[str, PooledCamera] = {}
    for name in (n for n in groups if n in doubted or n in single):
        partners = {*certain} - {name}
        chosen = [p for p in pairs if name in p.names and partners.intersection(p.names)]
        chosen.sort(key=lambda pair: -pair.row.num_inliers)
        tried = known | {name: _own(start[name], doubted=name in doubted)}
        some = {pair.index for pair in chosen[:_MOST_PAIRS]}
        refit = poses.estimated(tried, fit=True, only=some)
        exact = {n: c.as_exact() for n, c in tried.items() if n != name}
        refitted = fitted_pairs(refit)
        _, (found,) = pool({name: tried[name], **exact}, refitted)
        # A fit that tells little does not contradict pairs that agree, or tell as little.
        contradicts = doubted.get(name, True) and any(
            _ought_to_tell(p.row) for p in refitted if p.row.status != "mirrored"
        )
        if found.camera.focal_std < _TELLING_FOCAL_STD or contradicts:
            own[name] = found
        if squeezed := _squeezed(start[name], known, certain if name in single else []):
            other, camera = squeezed
            fixed = poses.estimated(known | {name: camera}, fit=False, only=some)
            if _inliers(fitted_pairs(fixed)) > _AS_MANY * _inliers(refitted):
                own[name] = replace(found, camera=camera, why=f"the camera of {other}, squeezed")
    return _together(start, pairs, own, known, certain)


def _together(
    start: Cameras,
    pairs: Sequence[FittedPair],
    own: Mapping[str, PooledCamera],
    known: Cameras,
    certain: Sequence[str],
) -> tuple[dict[str, Camera], list[PooledCamera]]:
    """The cameras of the groups, and those of the photographs that agree with none of them.

    own: of photographs by themselves. known: of the groups; certain: whose cameras are that.
    """
    groups = sharing(start)
    alone = {name: one.camera for name, one in own.items()}
    whose: dict[str, str] = {}  # camera a photograph has, where it is that of another
    for name, camera in ({n: known[n] for n in certain if n in groups} | alone).items():
        for other in certain:
            ranks = [(-len(groups.get(n, ())), groups.get(n, (n,))) for n in (other, name)]
            may_be = other not in own and (name in own or ranks[0] < ranks[1])
            if may_be and start[name].focal_source != "given" and _agrees(camera, known[other]):
                whose[name] = other
                break
    apart = [n for n in own if n not in whose or groups[n] != groups.get(whose[n])]
    members = {n: c for n, c in start.items() if n not in apart}
    kept = [pair for pair in pairs if not {*apart}.intersection(pair.names)]
    pooled, listed = pool(members, _within(kept, groups))
    rest, others = pool(members, kept)  # of cameras that their group does not determine
    cameras = {name: (pooled if name in certain else rest)[name] for name in members}
    listed = [one for one in listed if one.names[0] in certain]
    listed += [one for one in others if one.names[0] not in certain]
    why = "its pairs agree with no other camera"
    listed += [replace(own[n], why=own[n].why or why) for n in apart]
    cameras |= {name: own[name].camera for name in apart}
    for name, other in whose.items():
        size = start[name].size
        assert size is not None
        if groups[name] != groups.get(other):  # off by the same factor
            warnings = start[name].warnings
            cameras[name] = replace(cameras[other].resized(size), warnings=warnings)
    for number, one in enumerate(listed):
        first = one.names[0]
        if first in whose and (first in apart or first not in own):
            why = f"the camera of {whose[first]}, at its size"
            listed[number] = replace(one, camera=cameras[first], why=why)
    return {name: cameras[name] for name in start}, listed


def _by_models(cameras: Cameras, pairs: Sequence[FittedPair]) -> Cameras:
    """The cameras before the fit by the model that most of their pairs agree with."""
    groups = sharing(cameras)
    weights: dict[str, dict[ModelName, float]] = defaultdict(lambda: defaultdict(float))
    for row in (pair.row for pair in pairs if pair.row.success):
        for name in {groups[n][0] for n in row.names if n in groups}:
            weights[name][row.camera_model] += 1.0 if row.probability is None else row.probability
    changed = dict(cameras)
    for name, names in groups.items():
        of_group = weights[names[0]]
        for model, weight in of_group.items():
            if weight > sum(of_group.values()) / 2 and (model != "zoomed" or len(names) == 1):
                changed[name] = with_model(cameras[name], model)
    return changed


def _within(pairs: Sequence[FittedPair], groups: Mapping[str, tuple[str, ...]]) -> list[FittedPair]:
    """The pairs of one camera, and those of images of which none is of a group."""
    inside = []
    for pair in pairs:
        first, second = (groups.get(name, (name,)) for name in pair.names)
        if first == second or max(len(first), len(second)) == 1:
            inside.append(pair)
    return inside


def _agreement(
    name: str, names: Sequence[str], known: Cameras, pairs: Sequence[FittedPair]
) -> tuple[int, int]:
    """How many pairs of an image with its group agree with the group's camera, and how many ought
    to tell."""
    camera, agreeing, count = known[name], 0, 0
    for pair in pairs:
        if name in pair.names and set(pair.names) <= set(names):
            count += _ought_to_tell(pair.row)
            if pair.row.success and pair.fits is not None:
                value, *covariance = pair.fits[pair.names.index(name)][:, 0]
                off = abs(value - math.log(camera.focal))
                std = math.hypot(math.sqrt(covariance[0]), camera.focal_std, _SAME_FOCAL)
                agreeing += off < _AGREEING_STDS * std and pair.row.camera_model == "assumed"
    return agreeing, count


def _squeezed(camera: Camera, known: Cameras, certain: Sequence[str]) -> tuple[str, Camera] | None:
    """The first photograph of another shape, and its camera with each side resized by itself."""
    for other in certain if camera.focal_source != "given" else ():
        size = known[other].size
        if camera.size and size and not same_shape(camera.size, size):
            return other, known[other].resized(camera.size)
    return None


def _ought_to_tell(row: PairRow) -> bool:
    """Whether a pair has what it takes to determine its cameras."""
    if row.status == "mirrored":  # perhaps because of a wrong camera
        return row.num_matches >= _MIN_INLIERS
    return row.num_inliers >= _MIN_INLIERS and row.status not in ("rotation_only", "same_picture")


def _inliers(pairs: Sequence[FittedPair]) -> int:
    """Of all pairs with a pose."""
    return sum(pair.row.num_inliers for pair in pairs if pair.row.success)


def _own(camera: Camera, *, doubted: bool) -> Camera:
    """The camera of a photograph by itself, which may be zoomed or cut unless EXIF data say what it
    is and nothing contradicts them."""
    camera = replace(camera, identity=None)
    if not doubted and camera.focal_source != "size" and camera.focal_std < SIZE_STD:
        return camera
    centre_std = _CENTRE_OF_PART * max(camera.size or (0,))
    return replace(camera, focal_std=SIZE_STD, centre_std=centre_std)


def _agrees(camera: Camera, other: Camera) -> bool:
    """Whether a camera that is fitted by itself is that of another image, perhaps resized."""
    assert camera.size is not None and other.size is not None
    if camera.focal_std > _TELLING_FOCAL_STD or not same_shape(camera.size, other.size):
        return False
    other = other.resized(camera.size)
    off = abs(math.log(camera.focal / other.focal))
    shift = float(np.abs(camera.K[:2, 2] - other.K[:2, 2]).max())
    return off < _SAME_STDS * math.hypot(
        camera.focal_std, other.focal_std, _SAME_FOCAL
    ) and shift < _AGREEING_STDS * math.hypot(camera.centre_std, other.centre_std)
