"""Two views of a seeded scene with procedural textures, as NumPy arrays with the truth about them,
and as posed RGB-D folders."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation
from textures import drawn_photos
from torch import Tensor
from torch.nn.functional import normalize

from dgc_pose.training.draw import Draw
from dgc_pose.training.room_pairs import RoomOptions, Rooms, overlap, random_rooms, render
from dgc_pose.training.views import Cameras, image_arrays

_OPTIONS = RoomOptions(boxes=12, ellipsoids=4, spans=((1.0, 2.0), (0.5, 1.0)))
_TRIES = 12  # scenes drawn, of which the one whose views share enough is taken
_ENOUGH = 0.5
_DISTANCE = 2.0  # of a camera from what it looks at
_PLANE_SPAN = 2.2  # that the texture of the plane covers: not periodic, it looks alike nowhere
_photos = lru_cache(maxsize=1)(lambda: drawn_photos(18, 384))


@dataclass(frozen=True, eq=False)
class RenderedPair:
    """Two views with the truth about them. Pixel (0, 0) is the top-left pixel's centre."""

    image1: np.ndarray  # (h1, w1, 3) uint8, RGB
    image2: np.ndarray  # (h2, w2, 3) uint8, RGB
    K1: np.ndarray  # (3, 3) float64, pixels
    K2: np.ndarray  # (3, 3) float64, pixels
    R: np.ndarray  # (3, 3) float64, x2 = R x1 + t
    t: np.ndarray  # (3,) float64, units of the scene; zero for rotation_only
    depth1: np.ndarray  # (h1, w1), along the optical axis
    depth2: np.ndarray  # (h2, w2)


def render_scene_pair(
    seed: int,
    *,
    size1: tuple[int, int],
    size2: tuple[int, int],
    rotation_deg: float = 15.0,
    kind: Literal["general", "planar", "rotation_only"] = "general",
) -> RenderedPair:
    """A pair whose cameras differ by a rotation of exactly `rotation_deg`; images of one size are
    of one camera.

    Sizes are (width, height). kind: "general", objects in a room, orbited; "planar", the same
    motion before a single plane; "rotation_only", the room from one centre.
    """
    draw = Draw("cpu", seed, kind)
    rooms, look = random_rooms(_TRIES, _photos(), draw, _OPTIONS)
    azimuth = draw.uniform(_TRIES, high=2 * math.pi)
    height = torch.deg2rad(draw.uniform(_TRIES, low=5, high=30))
    level = height.cos()
    towards = torch.stack([azimuth.sin() * level, -height.sin(), azimuth.cos() * level], -1)
    if kind == "planar":
        look = 0 * look
        rooms = _planes(rooms, towards, draw)
    roll = torch.zeros(_TRIES)
    first = Cameras.looking(_K(seed, size1), look + _DISTANCE * towards, look, roll)
    axis = 0.3 * draw.normal(_TRIES, 3)
    axis[:, 1] = draw.choice((-1.0, 1.0))
    turn = (math.radians(rotation_deg) * normalize(axis, dim=-1)).double()
    turn = torch.from_numpy(Rotation.from_rotvec(turn).as_matrix()).float()
    rotation2 = turn @ first.pose[..., :3]
    centre2 = first.centre
    if kind != "rotation_only":
        distance2 = _DISTANCE * draw.uniform(_TRIES, 1, low=0.9, high=1.1)
        centre2 = look - distance2 * rotation2[:, 2]
    second = Cameras.at(_K(seed, size2), rotation2, centre2)
    shared = overlap(rooms, first, second, size2[::-1]).clamp(max=_ENOUGH)
    for camera in (first, second):
        place = torch.einsum("bji,bj->bi", rooms.axes[:, 0], camera.centre)
        shared -= (place.abs() > 0.97 * rooms.half[:, 0]).any(1).float()
    best = shared.argmax()[None]
    pair = _rendered(rooms.chosen(best), first[best], second[best], size1[::-1], size2[::-1])
    return replace(pair, t=0 * pair.t) if kind == "rotation_only" else pair


def _rendered(rooms, first, second, shape1, shape2) -> RenderedPair:
    pose = second.seen_by(first).pose[0].double().numpy()
    U, _, Vt = np.linalg.svd(pose[:, :3])  # the nearest rotation: these are in single precision
    K = [camera.K[0].double().numpy() for camera in (first, second)]
    views = [
        render(rooms, camera, shape, _photos().bank)
        for camera, shape in ((first, shape1), (second, shape2))
    ]
    return RenderedPair(
        *(image_arrays(image)[0] for image, _ in views),
        *(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]) for fx, fy, cx, cy in K),
        U @ Vt,
        pose[:, 3],
        *(depth[0].double().numpy() for _, depth in views),
    )


def _planes(rooms: Rooms, towards: Tensor, draw: Draw) -> Rooms:
    """A single plane through the origin each, tilted by up to 30 degrees to the direction
    `towards` (B, 3), in a hall too large to be seen."""
    count, values = len(towards), (0, 0, _PLANE_SPAN, 0.5, 0.5, 1)
    normal = towards + 0.3 * draw.uniform(count, 3, low=-1)
    facing = Cameras.looking(torch.ones(count, 4), normal, 0 * normal, torch.zeros(count))
    axes = facing.pose[:, None, :, :3].mT.expand(-1, 2, -1, -1)
    half = torch.tensor([[100.0, 100, 100], [20, 20, 0.001]]).expand(count, 2, 3)
    parts = zip(rooms[2:-1], values, strict=True)
    return Rooms(axes, half, *(torch.full_like(part[:, :2], value) for part, value in parts), 0)


def _K(seed: int, size: tuple[int, int]) -> Tensor:
    """fx fy cx cy (B, 4) of a camera of `size` (width, height)."""
    draw = Draw("cpu", seed, size)
    focal = max(size) * draw.uniform(1, low=1.0, high=1.4)
    centre = (torch.tensor(size) - 1) / 2 + max(size) * draw.uniform(2, low=-0.03, high=0.03)
    return torch.cat([focal, focal, centre]).expand(_TRIES, 4)


def rendered(seed: int, size: tuple[int, int], rotation_deg: float = 12.0) -> RenderedPair:
    """Two views (width, height) of a random scene by one camera, with the truth about them."""
    return render_scene_pair(seed, size1=size, size2=size, rotation_deg=rotation_deg)


def write_rgbd(root: Path, pair: RenderedPair) -> Path:
    """Both views of a pair in the layout of posed RGB-D, metres; file numbers have gaps."""
    lines = []
    views = ((pair.image1, pair.depth1), (pair.image2, pair.depth2))
    for name in ("images", "depth"):
        (root / name).mkdir(parents=True)
    for number, (image, depth), cam_from_world in zip((3, 17), views, poses(pair), strict=True):
        cv2.imwrite(str(root / "images" / f"{number:05d}.png"), image[..., ::-1])
        cv2.imwrite(str(root / f"depth/{number:05d}.png"), (1000 * depth).round().astype(np.uint16))
        lines.append(" ".join(map(repr, np.linalg.inv(cam_from_world).reshape(-1).tolist())))
    (root / "poses.txt").write_text("\n".join(lines) + "\n")
    np.savetxt(root / "K.txt", pair.K1)
    return root


def poses(pair: RenderedPair) -> tuple[np.ndarray, np.ndarray]:
    """cam_from_world (4, 4) of both views, metres."""
    first, relative = np.eye(4), np.eye(4)
    first[:3, :3] = cv2.Rodrigues(np.array([0.3, -0.5, 0.2]))[0]
    first[:3, 3] = (5.0, -2.0, 1.0)
    relative[:3, :3], relative[:3, 3] = pair.R, pair.t
    return first, relative @ first
