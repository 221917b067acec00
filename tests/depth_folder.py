"""Posed RGB-D folders and MVSNet folders of rendered scenes, as their makers lay them out."""

from pathlib import Path

import cv2
import numpy as np
import torch
from procedural import procedural_textures

from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import SceneOptions
from dgc_pose.training.synthesis.render.bank import TextureBank
from dgc_pose.training.synthesis.render.cameras import Cameras, axis_angle, look_at
from dgc_pose.training.synthesis.render.random_scene import random_scene
from dgc_pose.training.synthesis.render.rendered_pairs import (
    RenderedPair,
    Views,
    as_arrays,
    render_views,
)

METRES = 4.0  # a rendered scene's unit of length, so that millimetres are fine enough


def rendered(seed: int, size: tuple[int, int], rotation_deg: float = 12.0) -> RenderedPair:
    """Two views (width, height) of a random scene by one camera, with the truth about them."""
    draw = Draw(torch.Generator().manual_seed(seed), torch.device("cpu"), torch.float64)
    width, height = size
    K = torch.tensor([[1.1 * width, 0, 0.48 * width], [0, 1.2 * width, 0.51 * height], [0, 0, 1]])
    K = K.double()[None]
    centre1 = torch.tensor([[0.3, -0.5, -1.2]], dtype=torch.float64)
    rotation1 = look_at(centre1, torch.zeros_like(centre1))
    axis = torch.tensor([[0.2, 0.97, 0.1]], dtype=torch.float64)
    angle = torch.tensor([rotation_deg], dtype=torch.float64).deg2rad()
    rotation2 = axis_angle(axis / axis.norm(), angle) @ rotation1
    centre2 = -1.35 * rotation2[:, 2]
    first, second = (
        Cameras(K, rotation, -(rotation @ centre[..., None])[..., 0], size)
        for rotation, centre in ((rotation1, centre1), (rotation2, centre2))
    )
    bank = TextureBank.from_photos(procedural_textures(4, 128, seed=seed))
    options = SceneOptions(boxes=2, ellipsoids=1, quads=1, texture_span=(0.5, 0.9), shading=0.0)
    scene = random_scene(draw, first, second, bank.size, bank.count, options)
    views = Views(scene, first, second)
    return as_arrays(render_views(views, bank, options, scene.light))


def write_rgbd(root: Path, pair: RenderedPair) -> Path:
    """Both views of a pair in the layout of posed RGB-D; file numbers have gaps."""
    (root / "images").mkdir(parents=True)
    (root / "depth").mkdir()
    lines = []
    views = ((pair.image1, pair.depth1), (pair.image2, pair.depth2))
    for number, (image, depth), cam_from_world in zip((3, 17), views, poses(pair), strict=True):
        cv2.imwrite(str(root / "images" / f"{number:05d}.png"), image[..., ::-1])
        millimetres = np.where(np.isfinite(depth), 1000 * METRES * depth, 0).round()
        cv2.imwrite(str(root / "depth" / f"{number:05d}.png"), millimetres.astype(np.uint16))
        lines.append(" ".join(map(repr, np.linalg.inv(cam_from_world).reshape(-1).tolist())))
    (root / "poses.txt").write_text("\n".join(lines) + "\n")
    np.savetxt(root / "K.txt", pair.K1)
    return root


def poses(pair: RenderedPair) -> tuple[np.ndarray, np.ndarray]:
    """cam_from_world (4, 4) of both views, metres."""
    first = np.eye(4)
    first[:3, :3] = cv2.Rodrigues(np.array([0.3, -0.5, 0.2]))[0]
    first[:3, 3] = (5.0, -2.0, 1.0)
    relative = np.eye(4)
    relative[:3, :3], relative[:3, 3] = pair.R, METRES * pair.t
    return first, relative @ first
