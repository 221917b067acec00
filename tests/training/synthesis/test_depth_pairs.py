"""Pairs from depth and poses, against the rendered truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from depth_folder import rendered, write_rgbd
from procedural import procedural_textures

from dgc_pose.errors import InputError
from dgc_pose.training.map_pairs import MapPairs
from dgc_pose.training.synthesis.depth_pairs import depth_pairs
from dgc_pose.training.synthesis.depth_scenes import (
    DepthScenes,
    FramePairOptions,
    load_depth_scenes,
    training_frames,
)
from dgc_pose.training.synthesis.options import DepthOptions, PairOptions
from dgc_pose.training.synthesis.photos import Photos
from dgc_pose.training.synthesis.posed_depth import read_rgbd
from dgc_pose.training.synthesis.random_pairs import make_pairs
from dgc_pose.training.synthesis.render.rendered_pairs import RenderedPair

_ALL = FramePairOptions(overlap=(0.0, 1.0), baseline=(0.0, 10.0), rotation_deg=180.0)
_WHOLE = DepthOptions(view_scale=(1.0, 1.0), view_roll_deg=0.0)
_SIDE = 96


@pytest.fixture(scope="module")
def pair() -> RenderedPair:
    return rendered(3, (_SIDE, _SIDE))


@pytest.fixture(scope="module")
def scenes(pair: RenderedPair, tmp_path_factory: pytest.TempPathFactory) -> DepthScenes:
    root = write_rgbd(tmp_path_factory.mktemp("rgbd") / "walk", pair)
    return load_depth_scenes([read_rgbd(root)], _ALL, side=_SIDE)


def _only_forward(scenes: DepthScenes) -> DepthScenes:
    """The pair whose source is frame 0 and whose target is frame 1, as it was rendered."""
    chosen = (scenes.pairs[:, 0] == 0).nonzero()[:, 0]
    poses = scenes.source_from_target[chosen]
    return replace(scenes, pairs=scenes.pairs[chosen], source_from_target=poses)


def test_the_map_is_the_rendered_one(pair: RenderedPair, scenes: DepthScenes) -> None:
    found = depth_pairs(_only_forward(scenes), 1, _SIDE, torch.Generator().manual_seed(0), _WHOLE)
    known, valid = found.known[0].numpy(), found.valid[0].numpy()
    assert known.mean() > 0.75 and 0.3 < valid.mean() < 0.95 and (known & ~valid).mean() > 0.03
    error = np.linalg.norm(found.map[0].numpy() - pair.map, axis=-1)
    assert np.quantile(error[valid], 0.99) < 0.15 and error[valid].max() < 1.0
    # Visible by the ray-caster and by depth agreement are the same, but for a few at the edges.
    assert (valid == pair.visible)[known].mean() > 0.98
    np.testing.assert_allclose(found.image2[0].permute(1, 2, 0), pair.image2 / 255, atol=1e-4)


def test_views_cut_from_frames_look_alike_where_valid(scenes: DepthScenes) -> None:
    pairs = depth_pairs(scenes, 4, 64, torch.Generator().manual_seed(5), DepthOptions())
    fetched = F.grid_sample(pairs.image1, (2 * pairs.map + 1) / 64 - 1, align_corners=False)
    difference = (fetched - pairs.image2).abs().mean(1)
    assert pairs.valid.float().mean() > 0.2 and difference[pairs.valid].median() < 0.03
    shuffled = (fetched - pairs.image2.flip(-1)).abs().mean(1)
    assert difference[pairs.valid].mean() < 0.4 * shuffled[pairs.valid].mean()
    assert not (pairs.valid & ~pairs.known).any() and pairs.map.isfinite().all()


def test_depth_that_lacks_is_not_known(scenes: DepthScenes) -> None:
    blind = replace(scenes, depth=torch.zeros_like(scenes.depth))
    pairs = depth_pairs(blind, 1, 32, torch.Generator().manual_seed(5), DepthOptions())
    assert not pairs.known.any() and not pairs.valid.any()


def test_a_rectangle_squared_keeps_the_truth(tmp_path: Path) -> None:
    """K changes by each axis' own factor, and so do the points of the depth."""
    pair = rendered(4, (96, 64))
    scenes = load_depth_scenes([read_rgbd(write_rgbd(tmp_path / "a", pair))], _ALL, side=48)
    found = depth_pairs(_only_forward(scenes), 1, 48, torch.Generator().manual_seed(0), _WHOLE)
    valid = found.valid[0].numpy()
    assert valid.mean() > 0.3
    x, y = np.meshgrid(np.arange(48), np.arange(48))
    # A square's pixel lies between two columns, at a third between two rows of the rectangle.
    column, row = (x + 0.5) * 2 - 0.5, (y + 0.5) * 64 / 48 - 0.5
    grid = np.stack([(2 * column + 1) / 96 - 1, (2 * row + 1) / 64 - 1], -1)
    planes = torch.tensor(pair.map).permute(2, 0, 1)[None]
    sampled = F.grid_sample(planes, torch.tensor(grid)[None], align_corners=False)[0]
    truth = (sampled.permute(1, 2, 0).numpy() + 0.5) * (0.5, 48 / 64) - 0.5
    error = np.linalg.norm(found.map[0].numpy() - truth, axis=-1)[valid]
    assert np.median(error) < 0.02 and np.quantile(error, 0.95) < 0.15


def test_pairs_turn_within_the_range(tmp_path: Path) -> None:
    frames = read_rgbd(write_rgbd(tmp_path / "a", rendered(5, (64, 64), rotation_deg=15.0)))
    assert len(load_depth_scenes([frames], replace(_ALL, rotation_deg=16.0), side=64).pairs) == 2
    with pytest.raises(InputError, match="no two overlap"):
        load_depth_scenes([frames], replace(_ALL, rotation_deg=14.0), side=64)


def test_scenes_do_not_mix(tmp_path: Path) -> None:
    roots = [write_rgbd(tmp_path / str(seed), rendered(seed, (48, 48))) for seed in (3, 5)]
    scenes = load_depth_scenes([read_rgbd(root) for root in roots], _ALL, side=48)
    assert sorted(map(tuple, scenes.pairs.tolist())) == [(0, 1), (1, 0), (2, 3), (3, 2)]
    median = [float(scenes.depth[k : k + 2].float().median()) for k in (0, 2)]
    assert median == pytest.approx([1.0, 1.0], abs=0.05)


def test_the_end_of_the_walk_is_held_back(pair: RenderedPair, tmp_path: Path) -> None:
    frames = read_rgbd(write_rgbd(tmp_path / "a", pair)) * 5
    assert training_frames(frames) == frames[:9]


def test_make_pairs_mixes_real_scenes_in(scenes: DepthScenes) -> None:
    photos = Photos.of((255 * procedural_textures(6, 64, seed=0)).byte())
    options = PairOptions(scene_share=0.3, real_share=0.4, photometric=None)

    def made(seed: int) -> MapPairs:
        return make_pairs(photos, 24, 48, torch.Generator().manual_seed(seed), options, scenes)

    pairs = made(0)
    real = ~pairs.known.all(-1).all(-1)
    assert 4 <= int(real.sum()) <= 15 and real[-1] and not real[0]
    assert torch.equal(pairs.map, made(0).map) and not torch.equal(pairs.map, made(1).map)
    with pytest.raises(InputError, match="no real scenes"):
        make_pairs(photos, 2, 48, torch.Generator(), options)
    with pytest.raises(InputError, match="shares of one"):
        PairOptions(scene_share=0.7, real_share=0.4)
