"""Training pairs: the truth they carry, checked by geometry done another way in float64."""

import numpy as np
import pytest
import torch
from procedural import procedural_textures
from torch.nn.functional import grid_sample

from dgc_pose.training.synthesis.options import SceneOptions
from dgc_pose.training.synthesis.render.bank import TextureBank
from dgc_pose.training.synthesis.render.rendered_pairs import RenderedPairs, render_pairs

SIZE = 64
BATCH = 12


@pytest.fixture(scope="module")
def bank() -> TextureBank:
    return TextureBank.from_photos(procedural_textures(9, 96))


def rendered(bank: TextureBank, seed: int = 0, size: int = SIZE, **options) -> RenderedPairs:
    generator = torch.Generator().manual_seed(seed)
    return render_pairs(bank, BATCH, size, generator, SceneOptions(**options))


@pytest.fixture(scope="module")
def pairs(bank: TextureBank) -> RenderedPairs:
    return rendered(bank)


def points_of_view(K: torch.Tensor, depth: torch.Tensor) -> np.ndarray:
    """Points (h, w, 3) in the camera, float64, by the inverse of K."""
    height, width = depth.shape
    y, x = np.mgrid[:height, :width].astype(np.float64)
    rays = np.stack((x, y, np.ones_like(x)), axis=-1) @ np.linalg.inv(K.double().numpy()).T
    return rays * depth.double().numpy()[..., None]


def points_in_first(pairs: RenderedPairs, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Place (h, w, 2) in image 1 of each pixel of image 2, and depth there, from depth and pose."""
    pose = pairs.cam2_from_cam1[k].double().numpy()
    points2 = points_of_view(pairs.K2[k], pairs.depth2[k])
    points1 = (points2 - pose[:, 3]) @ np.linalg.inv(pose[:, :3]).T
    seen = points1 @ pairs.K1[k].double().numpy().T
    with np.errstate(divide="ignore", invalid="ignore"):
        return seen[..., :2] / seen[..., 2:], points1[..., 2]


def test_map_is_the_projection_of_the_surface_point(pairs):
    for k in range(BATCH):
        points, depth = points_in_first(pairs, k)
        ahead = depth > 0.05
        error = np.abs(pairs.map[k].numpy() - points)[ahead]
        assert (error / np.maximum(1, np.abs(points[ahead]) / SIZE)).max() < 2e-3
        assert (pairs.map[k].numpy()[depth < -0.05] == -1).all()


def test_poses_are_rotations_of_the_asked_size(bank):
    pairs = rendered(bank, rotation_deg=(10.0, 30.0), roll_deg=0.0)
    R = pairs.cam2_from_cam1[..., :3].double()
    identity = torch.eye(3, dtype=torch.float64).expand_as(R)
    assert torch.allclose(R @ R.mT, identity, atol=1e-6)
    angles = torch.rad2deg(torch.acos((R.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2))
    assert (angles > 9.99).all() and (angles < 30.01).all() and angles.std() > 2
    assert (pairs.K1[:, 0, 0] / SIZE).min() >= 0.7 and (pairs.K1[:, 0, 0] / SIZE).max() <= 2.0
    assert not torch.allclose(pairs.K1, pairs.K2)


def nearest_depth_around(depth: torch.Tensor, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest depth of image 1 over the four pixels around each place."""
    corner = np.clip(np.floor(points).astype(int), 0, SIZE - 2)
    x, y = corner[:, 0], corner[:, 1]
    around = np.stack([depth.numpy()[y + i, x + j] for i in (0, 1) for j in (0, 1)])
    return around.min(0), around.max(0)


def test_visible_means_the_depth_of_image_1_agrees(pairs):
    """Visibility is decided by casting rays, and is checked here with the depth of image 1."""
    wrong_visible = wrong_hidden = total_visible = total_hidden = 0
    for k in range(BATCH):
        points, depth = points_in_first(pairs, k)
        with np.errstate(invalid="ignore"):
            inside = (depth > 0) & (points >= 0).all(-1) & (points <= SIZE - 1).all(-1)
        visible = pairs.visible[k].numpy()
        assert not (visible & ~inside).sum() > 2  # a place on the border to a rounding error
        nearest, farthest = nearest_depth_around(pairs.depth1[k], points[inside])
        shown, z = visible[inside], depth[inside]
        wrong_visible += (shown & ((z < 0.98 * nearest) | (z > 1.02 * farthest))).sum()
        total_visible += shown.sum()
        # Hidden: image 1 shows something nearer at one of the pixels around.
        wrong_hidden += (~shown & (nearest > 0.998 * z)).sum()
        total_hidden += (~shown).sum()
    assert total_hidden > 1000 and total_visible > 10000
    assert wrong_visible / total_visible < 0.003
    assert wrong_hidden / total_hidden < 0.003


def test_visible_pixels_look_alike_without_shading(bank):
    """Smooth textures without light: image 1 sampled at the map is image 2 where visible."""
    smooth = torch.nn.functional.interpolate(
        torch.rand(6, 3, 5, 5, generator=torch.Generator().manual_seed(1)), (96, 96), mode="bicubic"
    ).clamp(0, 1)
    pairs = rendered(TextureBank.from_photos(smooth), size=96, shading=0.0, log_scale=0.1)
    warped = grid_sample(pairs.image1, pairs.map / 95 * 2 - 1, align_corners=True)
    difference = (warped - pairs.image2).abs().mean(1)
    assert difference[pairs.visible].median() < 0.01
    assert difference[pairs.visible].mean() < 0.25 * difference[~pairs.visible].mean()


def test_shading_and_shadow_only_darken(bank):
    flat = rendered(bank, shading=0.0)
    shaded = rendered(bank, shading=0.5)
    shadowed = rendered(bank, shading=0.5, shadow=0.5)
    assert (shaded.image1 <= flat.image1 + 1e-6).all()
    assert (shadowed.image1 <= shaded.image1 + 1e-6).all()
    share = (shadowed.image1 < 0.9 * shaded.image1).any(1).float().mean()
    assert 0.02 < share < 0.98


def test_pairs_overlap(bank):
    share = rendered(bank, seed=3, min_overlap=0.3, tries=12).visible.float().mean((1, 2))
    assert share.min() > 0.25  # the probe that decides is coarser than the image
    assert rendered(bank, seed=3, min_overlap=0.0).visible.float().mean((1, 2)).min() < share.min()


def test_supersampling_is_the_mean_of_the_samples(bank):
    """Rendered at twice the size with the same cameras, then averaged over 2x2 pixels."""
    once = rendered(bank, light_change=0.0)
    twice = rendered(bank, supersample=2, light_change=0.0)
    assert torch.equal(once.map, twice.map)
    double = rendered(bank, size=2 * SIZE, light_change=0.0)
    averaged = torch.nn.functional.avg_pool2d(double.image1, 2)
    assert (averaged - twice.image1).abs().median() < 2e-3
    assert (averaged - once.image1).abs().mean() > 2 * (averaged - twice.image1).abs().mean()
