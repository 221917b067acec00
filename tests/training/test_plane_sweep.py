"""Depths of a plane sweep, against those of a ray-caster in float64."""

import cv2
import numpy as np
import pytest
import torch
import worlds

from dgc_pose.training.photos import ImageBank
from dgc_pose.training.plane_sweep import swept_depths
from dgc_pose.training.views import Cameras

pytestmark = pytest.mark.slow


def _swept(images, K, poses, reach):
    """Depths by pixels, fx fy cx cy of all, [R | t] and the range of depths."""
    count, poses = len(images), torch.from_numpy(np.stack(poses)).float()
    cameras = Cameras(torch.tensor([K]).float().expand(count, 4), poses)
    return swept_depths(ImageBank.of(images), cameras, torch.tensor([reach]).expand(count, 2))


def test_depths_are_those_of_the_scene():
    views, K = worlds.render_views(5, step=0.5), worlds.K
    intrinsics = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    poses = [np.column_stack([view.R, view.t]) for view in views]
    found = _swept([view.pixels for view in views], intrinsics, poses, (2.5, 9.0))
    for k in (1, 2, 3):
        textures = worlds.draw_textures()
        truth = worlds.render(views[k].R, views[k].centre, textures, fine=1)[1]
        depth = found[k].numpy()
        assert depth.shape == truth.shape
        known = (depth > 0) & np.isfinite(truth)
        error = np.abs(depth[known] / truth[known] - 1)
        assert known.mean() > 0.3
        assert np.median(error) < 0.01 and (error < 0.03).mean() > 0.95


def test_views_of_many_pixels_have_the_depths_of_a_wall():
    """Their neighbours hang upside down, where a principal point that is off counts twice."""
    rng = np.random.default_rng(0)
    blots = rng.integers(0, 256, (60, 200, 3), dtype=np.uint8)
    wall = cv2.resize(blots, (2000, 600), interpolation=cv2.INTER_CUBIC)
    images, poses = [], []
    for shift, turned in ((0, 1), (60, -1), (100, -1)):  # pixels, on the wall at a depth of 4
        image = wall[100:420, 300 + shift : 1580 + shift]
        images.append(np.ascontiguousarray(image[::turned, ::turned]))
        poses.append(np.diag([turned, turned, 1.0, 0])[:3])
        poses[-1][:, 3] = (-turned * shift * 4 / 1000, 0, 0)
    depth = _swept(images, [1000.0, 1000, 639.5, 159.5], poses, (2.0, 8.0))[0]
    known = depth[depth > 0]
    assert depth.shape == (64, 256) and len(known) > 0.3 * depth.numel()
    assert abs(known.median() / 4 - 1) < 0.004
