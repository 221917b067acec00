"""Posed RGB-D folders of rendered scenes, as their makers lay them out."""

from pathlib import Path

import cv2
import numpy as np
from scene_pair import RenderedPair, render_scene_pair


def rendered(seed: int, size: tuple[int, int], rotation_deg: float = 12.0) -> RenderedPair:
    """Two views (width, height) of a random scene by one camera, with the truth about them."""
    return render_scene_pair(seed, size1=size, size2=size, rotation_deg=rotation_deg)


def write_rgbd(root: Path, pair: RenderedPair) -> Path:
    """Both views of a pair in the layout of posed RGB-D, metres; file numbers have gaps."""
    (root / "images").mkdir(parents=True)
    (root / "depth").mkdir()
    lines = []
    views = ((pair.image1, pair.depth1), (pair.image2, pair.depth2))
    for number, (image, depth), cam_from_world in zip((3, 17), views, poses(pair), strict=True):
        cv2.imwrite(str(root / "images" / f"{number:05d}.png"), image[..., ::-1])
        cv2.imwrite(str(root / f"depth/{number:05d}.png"), (1000 * depth).round().astype(np.uint16))
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
    relative[:3, :3], relative[:3, 3] = pair.R, pair.t
    return first, relative @ first
