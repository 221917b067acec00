from __future__ import annotations

import dense_scene
import numpy as np
import pytest
import torch
from command_line import run

from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import save_weights


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pictures(tmp_path)

    def load_dense_matcher(weights, *, options, **others):
        return dense_scene.MapMatcher(dense_scene.true_map(), options)

    monkeypatch.setattr("dgc_pose.matchers.load_dense_matcher", load_dense_matcher)
    return tmp_path


def match(*arguments):
    """With the map as it is; tests/cli/test_refine.py has what --refine makes of it."""
    return run("match", "--refine", "none", *arguments)


def test_map_and_matches_are_written(folder):
    result = match("one.png", "two.png", "--out", "m.npz", "--max-matches", "300")
    assert result.exit_code == 0
    truth = dense_scene.true_map()
    with np.load("m.npz", allow_pickle=False) as file:
        assert sorted(file) == ["confidence", "grid", "map", "matchability", "points1", "points2"]
        assert np.array_equal(file["map"], truth.map)
        assert np.array_equal(file["grid"], truth.grid)
        assert np.array_equal(file["matchability"], truth.matchability)
        count = len(file["confidence"])
        assert 0 < count <= 300
        assert file["points1"].shape == file["points2"].shape == (count, 2)
        off = dense_scene.points_in_image1(file["points2"]) - file["points1"]
        assert np.abs(off).max() < 1e-3
    assert f"{count} matches of {dense_scene.CELLS**2} cells" in result.stdout


def test_weights_from_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pictures(tmp_path)
    torch.manual_seed(0)
    save_weights(DGCNet(preset("dgcm-lite0")), "w.safetensors")
    options = ("--weights", "w.safetensors", "--device", "cpu", "--matchability", "0")
    result = match("one.png", "two.png", "--out", "m.npz", "--max-matches", "100", *options)
    assert result.exit_code == 0, result.stderr
    with np.load("m.npz", allow_pickle=False) as file:
        assert file["map"].shape == file["grid"].shape == (208, 272, 2)
        assert file["matchability"].shape == (208, 272)
        assert np.isfinite(file["map"]).all()
        # The grid's corners are the centres of cells of 320/272 by 240/208 pixels.
        corner = [320 / 544 - 0.5, 240 / 416 - 0.5]
        assert file["grid"][0, 0] == pytest.approx(corner, abs=1e-4)
        assert file["grid"][-1, -1] == pytest.approx(np.subtract([319, 239], corner), abs=1e-4)
