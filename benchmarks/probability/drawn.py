"""Pairs drawn from posed scenes, evenly over rotation and overlap: easy, hard and hopeless ones."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.dtu.dataset import open_dataset
from dgc_pose.benchmarks.dtu.view_pairs import (
    ViewPairOptions,
    draw,
    find_view_pairs,
    listed_pair,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import intrinsics
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import InputError
from dgc_pose.images.image import image_size
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.training.posed_frames import PosedFrame, reach_of, read_rgbd, read_scenes

_ROTATIONS = (0, 10, 20, 30, 45, 60, 90)  # degrees, edges of the bins
# Edges of the bins of overlap: share of image 2's depth that is seen in image 1, and points that
# two images of a sparse model have in common. The pairs of the first bin are hopeless.
_OVERLAPS = (0.0, 0.1, 0.25, 0.5, 1.01)
_COMMON = (0, 5, 25, 80, 10**9)
_NO_OVERLAP_SHARE = 0.15  # share of the pairs drawn that are
_LEAST_BASELINE = 0.08  # of the depth
_PROBE = 24  # depths along the longer side by which overlap is counted
_FRAMES = 60  # of a sequence, evenly chosen; all pairs of them are looked at
_AGREES = 0.05  # of the depth
_DTU_ROTATION = 60.0  # degrees
_DTU_OVERLAP = 0.2  # of the space at DTU's depths
# Posed photographs: edges of the bins of the larger of rotation and parallax, degrees, and how many
# pairs of each are taken in a turn.
_CHANGES = (10, 20, 35, 55)
_A_TURN = (1, 2, 3, 3, 2)
_LOOKED_AT = 1500  # pairs of a scene
_POSED_OVERLAP = 0.08  # of the space at three depths, in both directions


def drawn_rgbd(folder: Path, count: int, seed: int) -> list[Pair]:
    """Pairs of a folder of posed RGB-D frames. Raises as `read_rgbd` does."""
    frames = read_rgbd(folder)
    frames = frames[:: math.ceil(len(frames) / _FRAMES)]
    depths = [frame.read_depth() for frame in frames]
    pairs, overlaps = [], []
    for frame2, depth2 in zip(frames, depths, strict=True):
        points = _probes(frame2, depth2)
        for frame1, depth1 in zip(frames, depths, strict=True):
            T = frame2.cam_from_world @ np.linalg.inv(frame1.cam_from_world)
            if frame1 is frame2 or not len(points) or _is_still(T, np.median(points[:, 2])):
                continue
            names = (f"images/{frame.image.name}" for frame in (frame1, frame2))
            pairs.append(_pair(folder, [*names], [frame1.camera, frame2.camera], T))
            back = points @ T[:3, :3] - T[:3, 3] @ T[:3, :3]
            overlaps.append(_overlap(frame1, depth1, back))
    return _chosen(pairs, np.array(overlaps), _OVERLAPS, count, seed)


def drawn_sparse(folder: Path, count: int, seed: int) -> list[Pair]:
    """Pairs of a COLMAP model, without lens distortion, whose photographs lie in `images`.

    Raises InputError, with the path, if the model cannot be read or has distortion.
    """
    try:
        model = pycolmap.Reconstruction(str(folder))
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{folder}: no COLMAP model ({str(error).splitlines()[0]})") from None
    images = sorted(model.images.values(), key=lambda image: image.name)
    seen = [{p.point3D_id for p in image.points2D if p.has_point3D()} for image in images]
    cameras = [_pinhole(model.cameras[image.camera_id], folder) for image in images]
    world = [np.vstack([image.cam_from_world().matrix(), (0, 0, 0, 1)]) for image in images]
    pairs, common = [], []
    for i, j in permutations(range(len(images)), 2):
        shared = seen[i] & seen[j]
        points = np.array([model.points3D[k].xyz for k in shared or seen[j]]).reshape(-1, 3)
        depth = np.median(points @ world[j][2, :3] + world[j][2, 3]) if len(points) else 0.0
        T = world[j] @ np.linalg.inv(world[i])
        if not _is_still(T, depth):
            names = [f"images/{images[k].name}" for k in (i, j)]
            pairs.append(_pair(folder, names, [cameras[i], cameras[j]], T))
            common.append(len(shared))
    return _chosen(pairs, np.array(common), _COMMON, count, seed)


def drawn_posed(folder: Path, count: int, seed: int) -> list[Pair]:
    """Pairs of photographs of a folder of posed scenes, at most `count` of each, the wider ones
    more often. Names are relative to `folder`. Raises as `read_scenes` and `read_depth` do."""
    pairs, root = [], folder.resolve()
    for number, frames in enumerate(read_scenes(folder).values()):
        rng = np.random.default_rng(seed + number)
        bounded = [replace(f, reach=f.reach or reach_of(f.read_depth())) for f in frames]
        sized = [replace(f, camera=replace(f.camera, size=image_size(f.image))) for f in bounded]
        ways = list(permutations(sized, 2))
        rng.shuffle(ways)
        bins: list[list[Pair]] = [[] for _ in _A_TURN]
        for frame1, frame2 in ways[:_LOOKED_AT]:
            if min(_shared(frame1, frame2), _shared(frame2, frame1)) < _POSED_OVERLAP:
                continue
            names = [frame.image.relative_to(root).as_posix() for frame in (frame1, frame2)]
            T = frame2.cam_from_world @ np.linalg.inv(frame1.cam_from_world)
            pair = _pair(folder, names, [frame1.camera, frame2.camera], T)
            bins[int(np.digitize(_change_deg(frame1, pair), _CHANGES))].append(pair)
        chosen: list[Pair] = []
        while any(bins) and len(chosen) < count:
            for members, often in zip(bins, _A_TURN, strict=True):
                chosen += [members.pop() for _ in range(min(often, len(members)))]
        chosen = chosen[:count]
        rng.shuffle(chosen)
        pairs += chosen
    return pairs


def _change_deg(frame1: PosedFrame, pair: Pair) -> float:
    """The larger of the rotation and the parallax at the middle of camera 1's depths."""
    assert frame1.reach is not None and pair.R is not None and pair.t is not None
    parallax = math.atan(np.linalg.norm(pair.t) / math.sqrt(math.prod(frame1.reach)))
    return max(rotation_error_deg(pair.R, np.eye(3)), math.degrees(parallax))


def _shared(frame1: PosedFrame, frame2: PosedFrame) -> float:
    """Share of what camera 1 sees at three depths within its reach that camera 2 sees too."""
    assert frame1.reach and frame1.camera.size and frame2.camera.size
    (width1, height1), (width2, height2) = frame1.camera.size, frame2.camera.size
    T = frame2.cam_from_world @ np.linalg.inv(frame1.cam_from_world)
    x, y = np.meshgrid(np.arange(0.5, 8) * width1 / 8, np.arange(0.5, 8) * height1 / 8)
    pixels = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    rays = pixels @ np.linalg.inv(frame1.camera.K).T
    points = np.vstack([rays * depth for depth in np.geomspace(*frame1.reach, 5)[1:4]])
    seen = (points @ T[:3, :3].T + T[:3, 3]) @ frame2.camera.K.T
    x, y = (seen[:, :2] / np.maximum(seen[:, 2:], 1e-9)).T
    return float(((seen[:, 2] > 0) & (x > 0) & (x < width2) & (y > 0) & (y < height2)).mean())


def drawn_dtu(folder: Path, count: int, seed: int) -> list[Pair]:
    """Pairs of DTU, evenly over the rotations; names are relative to `folder`. Raises as
    `open_dataset` does."""
    dataset = open_dataset(folder)
    options = ViewPairOptions(
        pairs=count, max_rotation=_DTU_ROTATION, min_overlap=_DTU_OVERLAP, seed=seed
    )
    pairs = []
    for views in draw(find_view_pairs(dataset, options), options):
        pair = listed_pair(dataset, views)
        name1, name2 = (path.relative_to(folder).as_posix() for path in (pair.path1, pair.path2))
        pairs.append(replace(pair, name1=name1, name2=name2, root=folder))
    return pairs


def _chosen(
    pairs: Sequence[Pair], overlaps: np.ndarray, edges: Sequence[float], count: int, seed: int
) -> list[Pair]:
    """At most `count` pairs, one bin of rotation and overlap after the other in turn; those beyond
    the last rotation only among the hopeless."""
    rng = np.random.default_rng(seed)
    rotations = np.array([rotation_error_deg(pair.R, np.eye(3)) for pair in pairs])
    rotation, overlap = np.digitize(rotations, _ROTATIONS), np.digitize(overlaps, edges)
    apart = rng.permutation(np.flatnonzero(overlap == 1))[: round(_NO_OVERLAP_SHARE * count)]
    bins = [
        list(rng.permutation(np.flatnonzero((rotation == r) & (overlap == o))))
        for r in range(1, len(_ROTATIONS))
        for o in range(2, len(edges))
    ]
    chosen: list[int] = []
    while any(bins) and len(chosen) < count - len(apart):
        chosen += [int(members.pop()) for members in bins if members]
    chosen = chosen[: count - len(apart)] + apart.tolist()
    return [pairs[k] for k in sorted(chosen)]


def _is_still(T: np.ndarray, depth: float) -> bool:
    """Whether the baseline is too short: the direction of t is then the poses' noise."""
    return bool(np.linalg.norm(T[:3, 3]) < _LEAST_BASELINE * depth)


def _pair(folder: Path, names: Sequence[str], cameras: Sequence[Camera], T: np.ndarray) -> Pair:
    U, _, Vt = np.linalg.svd(T[:3, :3])  # the nearest rotation: stored poses are rounded
    return Pair(names[0], names[1], folder, cameras[0], cameras[1], U @ Vt, T[:3, 3])


def _probes(frame: PosedFrame, depth: np.ndarray) -> np.ndarray:
    """Points (N, 3), in the camera's axes, of pixels of known depth, evenly spread."""
    step = max(1, max(depth.shape) // _PROBE)
    y, x = np.mgrid[step // 2 : depth.shape[0] : step, step // 2 : depth.shape[1] : step]
    z = depth[y, x].astype(np.float64)
    known = z > 0
    pixels = np.stack([x[known], y[known]], -1).astype(np.float64)
    rays = (pixels - frame.camera.K[:2, 2]) / np.diag(frame.camera.K)[:2]
    return np.column_stack([rays, np.ones(len(rays))]) * z[known][:, None]


def _overlap(frame: PosedFrame, depth: np.ndarray, points: np.ndarray) -> float:
    """Share of points (N, 3), in the frame's axes, that it sees."""
    z = points[:, 2]
    pixels = (
        points[:, :2] / np.maximum(z, 1e-6)[:, None] * np.diag(frame.camera.K)[:2]
        + frame.camera.K[:2, 2]
    )
    column, row = np.rint(pixels.clip(-1e6, 1e6)).astype(int).T
    height, width = depth.shape
    inside = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    seen = depth[row.clip(0, height - 1), column.clip(0, width - 1)]
    unknown = inside & (seen == 0)
    visible = inside & (np.abs(seen - z) < _AGREES * z)
    counted = len(z) - int(unknown.sum())
    return float(visible.sum() / counted) if counted else 0.0


def _pinhole(camera: pycolmap.Camera, folder: Path) -> Camera:
    if len(camera.extra_params_idxs()):
        raise InputError(f"{folder}: {camera.model_name} has distortion; undistort the model")
    K, _ = intrinsics(camera.model_name, camera.params.tolist())
    return Camera(K, (camera.width, camera.height))
