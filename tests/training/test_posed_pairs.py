"""Pairs of posed frames whose images hold their own coordinates, by reprojection in float64."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from rendered import rendered, write_rgbd
from textures import coordinates

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.training import posed_pairs as posed_pairs_module
from dgc_pose.training.draw import Draw
from dgc_pose.training.photos import ImageBank
from dgc_pose.training.posed_frames import PosedFrame, read_rgbd
from dgc_pose.training.posed_pairs import (
    frame_pairs,
    load_posed,
    posed_pairs,
)
from dgc_pose.training.views import Cameras, pixel_grid

SIZE = (240, 180)


@pytest.fixture(scope="module")
def pair():
    return rendered(3, SIZE)


@pytest.fixture(scope="module")
def frames(pair, tmp_path_factory):
    images = [coordinates(*SIZE, level) for level in (50, 200)]  # blue of either frame
    folder = tmp_path_factory.mktemp("rgbd") / "walk"
    write_rgbd(folder, replace(pair, image1=images[0], image2=images[1]))
    return frame_pairs(load_posed({"walk": read_rgbd(folder)}, "cpu", folder / "depths"), ["walk"])


def test_the_map_is_the_reprojection_of_the_depth(pair, frames):
    shape = (80, 144)
    pairs = posed_pairs(frames, 8, shape, Draw("cpu", shape))
    place = (2 * pairs.map + 1) / pairs.map.new_tensor(shape[::-1]) - 1
    sources = 255 * F.grid_sample(pairs.image1, place, align_corners=False).movedim(1, -1)
    targets = 255 * pairs.image2.movedim(1, -1)
    K, both, errors = pair.K1, set(), []
    for source, target, valid in zip(sources, targets, pairs.valid, strict=True):
        seen, shown = (part[valid].double().numpy() for part in (source, target))
        forward = bool(shown[:, 2].mean() > 125)  # the target is the second frame
        both.add(forward)
        depth = pair.depth2 if forward else pair.depth1
        x, y = np.rint(shown[:, :2]).astype(int).T
        rays = np.column_stack([(shown[:, :2] - K[:2, 2]) / np.diag(K)[:2], np.ones(len(x))])
        points = rays * depth[y, x][:, None]
        points = (points - pair.t) @ pair.R if forward else points @ pair.R.T + pair.t
        flat = points[:, :2] / points[:, 2:] * np.diag(K)[:2] + K[:2, 2]
        errors.append(np.linalg.norm(flat - seen[:, :2], axis=1))
    error = np.concatenate(errors)
    assert both == {False, True} and len(error) > 0.25 * pairs.valid.numel()
    # The images hold whole pixels, and a depth is that of the nearest one.
    assert np.median(error) < 0.8 and np.quantile(error, 0.95) < 3
    assert not (pairs.valid & ~pairs.known).any() and pairs.map.isfinite().all()


def test_hidden_pixels_are_known_and_pixels_without_depth_are_not(frames):
    pairs = posed_pairs(frames, 6, (96, 96), Draw("cpu", 1))
    assert pairs.known.float().mean() > 0.8 and (pairs.known & ~pairs.valid).float().mean() > 0.05
    blind = replace(frames.scenes, depth=torch.zeros_like(frames.scenes.depth))
    pairs = posed_pairs(replace(frames, scenes=blind), 2, (96, 96), Draw("cpu", 1))
    assert not pairs.known.any() and not pairs.valid.any()


def test_the_lens_is_undone(tmp_path):
    lens = Distortion("SIMPLE_RADIAL", (-0.15,))
    camera = Camera([200, 200, 118, 92], distortion=lens)
    cv2.imwrite(str(tmp_path / "a.png"), coordinates(*SIZE, 0)[..., ::-1])
    frame = PosedFrame(tmp_path / "a.png", camera, np.eye(4), reach=(1.0, 2.0))
    scenes = load_posed({"a": [frame]}, "cpu", tmp_path / "depths")
    points = torch.tensor([[118.0, 92], [40, 30], [200, 150]])
    found = 255 * scenes.bank.sample(torch.tensor(0), points, torch.ones(3))[:, :2]
    normalised = (points.double().numpy() - (118, 92)) / 200
    np.testing.assert_allclose(found, camera.project(normalised), atol=0.6)


def test_frames_of_many_pixels_are_made_smaller_with_their_depth(tmp_path):
    x, y = np.meshgrid(np.arange(1280), np.arange(320))
    image = np.stack([x / 5, y / 5, np.zeros_like(x)], -1).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), image[..., ::-1])
    cv2.imwrite(str(tmp_path / "depth.png"), (2000 + 2 * x).astype(np.uint16))
    camera = Camera([1000, 1000, 639.5, 159.5])
    frame = PosedFrame(tmp_path / "a.png", camera, np.eye(4), tmp_path / "depth.png", reach=(1, 4))
    scenes = load_posed({"a": [frame]}, "cpu", tmp_path)  # in units of 2
    assert scenes.bank.size(torch.tensor(0)).tolist() == [512, 128]
    torch.testing.assert_close(scenes.cameras.K, torch.tensor([[400.0, 400, 255.5, 63.5]]))
    points = pixel_grid((128, 512), torch.device("cpu"))
    x = 2.5 * points[..., 0] + 0.75  # of the photograph's pixel
    off = 1000 * scenes.depth_at(torch.tensor([0]), points[None])[0] - 1000 - x
    assert off.abs().max() < 1.3 and abs(off.mean()) < 0.3
    found = 255 * 5 * scenes.bank.sample(torch.tensor(0), points, torch.ones(128, 512))[..., 0]
    assert abs((found - x).mean()) < 3  # of which 2 are rounding


def _wall(folder: Path, count: int, step: float) -> list[PosedFrame]:
    """A camera that moves sideways before a wall at a depth of 2, `step` a frame."""
    frames = []
    for number in range(count):
        image, depth = folder / f"{number}.png", folder / f"{number}_depth.png"
        cv2.imwrite(str(image), np.full((48, 64, 3), 90, np.uint8))
        cv2.imwrite(str(depth), np.full((48, 64), 2000, np.uint16))
        pose = np.eye(4)
        pose[0, 3] = -step * number
        frames.append(PosedFrame(image, Camera([40, 40, 31.5, 23.5]), pose, depth))
    return frames


def test_pairs_share_enough_and_far_ones_are_likelier(tmp_path):
    pairs = frame_pairs(load_posed({"wall": _wall(tmp_path, 10, 0.4)}, "cpu", tmp_path), ["wall"])
    apart = (pairs.frames[:, 0] - pairs.frames[:, 1]).abs()
    # A frame sees 3.2 of the wall across.
    assert sorted(set(apart.tolist())) == [n for n in range(1, 10) if 1 - 0.4 * n / 3.2 > 0.2]
    weight = pairs.chance.diff(prepend=torch.zeros(1))
    means = [float(weight[apart == n].mean()) for n in range(1, 6)]
    assert means == sorted(means) and means[4] > 2 * means[0]
    # The middle of what both show lies on the other's side in each.
    to_the_right = pairs.frames[:, 0] < pairs.frames[:, 1]
    assert (pairs.middles[to_the_right, 0, 0] > 31.5).all()
    assert (pairs.middles[to_the_right, 1, 0] < 31.5).all()


def test_scenes_do_not_mix_and_weigh_as_their_roots(tmp_path):
    walls = {"a": _wall(tmp_path, 4, 0.2), "b": _wall(tmp_path, 10, 0.2)}
    scenes = load_posed(walls, "cpu", tmp_path)
    pairs = frame_pairs(scenes, ["a", "b"])
    assert ((pairs.frames < 4).all(1) | (pairs.frames >= 4).all(1)).all()
    first = int((pairs.frames[:, 0] < 4).sum())
    ratio = float(pairs.chance[first - 1] / (pairs.chance[-1] - pairs.chance[first - 1]))
    assert ratio == pytest.approx((first / (len(pairs.frames) - first)) ** 0.5)


def test_swept_depths_are_kept_for_their_own_poses_alone(tmp_path, monkeypatch):
    swept: list[int] = []

    def counted(bank: ImageBank, views: Cameras, reach: torch.Tensor) -> list[torch.Tensor]:
        swept.append(len(reach))
        return [torch.full((2, 3), float(len(swept)))] * len(reach)

    monkeypatch.setattr(posed_pairs_module, "swept_depths", counted)
    for step, times in ((0.4, 1), (0.4, 1), (0.3, 2), (0.4, 2)):
        walls = [replace(f, depth=None, reach=(1, 4)) for f in _wall(tmp_path, 3, step)]
        scenes = load_posed({"wall": walls}, "cpu", tmp_path / "depths")
        assert len(swept) == times and scenes.depth.unique().tolist() == [2 if step == 0.3 else 1]
