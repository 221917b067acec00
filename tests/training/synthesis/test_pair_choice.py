"""Which frames of a posed walk make a pair, and which are drawn if there are many."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from dgc_pose.training.synthesis.depth_scenes import FramePairOptions, load_depth_scenes
from dgc_pose.training.synthesis.posed_depth import read_rgbd

FRAMES, STEP, DEPTH = 12, 0.15, 2.0  # metres


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A camera that moves sideways before a wall, STEP a frame."""
    root = tmp_path_factory.mktemp("walk")
    for name in ("images", "depth"):
        (root / name).mkdir()
    poses = []
    for number in range(FRAMES):
        cv2.imwrite(str(root / "images" / f"{number:05d}.png"), np.full((48, 64, 3), 90, np.uint8))
        wall = np.full((48, 64), 1000 * DEPTH, np.uint16)
        cv2.imwrite(str(root / "depth" / f"{number:05d}.png"), wall)
        world_from_camera = np.eye(4)
        world_from_camera[0, 3] = STEP * number
        poses.append(" ".join(map(str, world_from_camera.ravel())))
    (root / "poses.txt").write_text("\n".join(poses) + "\n")
    np.savetxt(root / "K.txt", [[40, 0, 31.5], [0, 40, 23.5], [0, 0, 1]])
    return root


def test_pairs_lie_within_the_ranges(walk: Path) -> None:
    choice = FramePairOptions(overlap=(0.5, 0.93), baseline=(0.1, 0.35))
    scenes = load_depth_scenes([read_rgbd(walk)], choice)
    apart = (scenes.pairs[:, 0] - scenes.pairs[:, 1]).abs()
    # A frame sees 64 / 40 depths of the wall across; a step is 0.075 depths.
    expected = {
        n
        for n in range(1, FRAMES)
        if 0.1 <= 0.075 * n <= 0.35 and 0.5 <= 1 - 0.075 * n * 40 / 64 <= 0.93
    }
    assert set(apart.tolist()) == expected
    assert len(scenes.pairs) == 2 * sum(FRAMES - n for n in expected)


def test_far_pairs_are_likelier_and_the_draw_repeats(walk: Path) -> None:
    ranges = dict(overlap=(0.3, 0.99), baseline=(0.01, 2.0))
    everything = load_depth_scenes([read_rgbd(walk)], FramePairOptions(**ranges))
    choice = FramePairOptions(**ranges, per_frame=3)
    drawn = [load_depth_scenes([read_rgbd(walk)], choice) for _ in range(2)]
    assert len(everything.pairs) > len(drawn[0].pairs) == 3 * FRAMES
    assert torch.equal(drawn[0].pairs, drawn[1].pairs)
    assert torch.equal(drawn[0].source_from_target, drawn[1].source_from_target)
    known = {
        tuple(pair): pose
        for pair, pose in zip(everything.pairs.tolist(), everything.source_from_target, strict=True)
    }
    for pair, pose in zip(drawn[0].pairs.tolist(), drawn[0].source_from_target, strict=True):
        assert torch.equal(known[tuple(pair)], pose)
    baseline = [
        scenes.source_from_target[:, 0, 3].abs().mean() for scenes in (everything, drawn[0])
    ]
    assert baseline[1] > 1.1 * baseline[0]
