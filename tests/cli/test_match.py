import dense_scene
import numpy as np
import PIL.Image
import pytest
import torch
from command_line import run

from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.training.run import save_weights

TRUE, OFF = dense_scene.true_map(), dense_scene.true_map(error_px=0.7)


@pytest.fixture
def network(tmp_path, monkeypatch):
    """Pictures and a list of them in the working folder; makes every network's map this one."""
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pair_list(tmp_path)

    def use(correspondence_map):
        def load_dense_matcher(weights, *, options, **others):
            return dense_scene.MapMatcher(correspondence_map, options)

        monkeypatch.setattr("dgc_pose.matchers.load_dense_matcher", load_dense_matcher)

    return use


def match(*arguments):
    return run("match", "one.png", "two.png", "--out", "m.npz", *arguments)


def test_map_and_matches_are_written(network):
    network(TRUE)
    result = match("--refine", "none", "--max-matches", "300")
    assert result.exit_code == 0
    with np.load("m.npz", allow_pickle=False) as file:
        assert sorted(file) == ["confidence", "grid", "map", "matchability", "points1", "points2"]
        assert np.array_equal(file["map"], TRUE.map)
        assert np.array_equal(file["grid"], TRUE.grid)
        assert np.array_equal(file["matchability"], TRUE.matchability)
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
    result = match("--refine", "none", "--max-matches", "100", *options)
    assert result.exit_code == 0, result.stderr
    with np.load("m.npz", allow_pickle=False) as file:
        assert file["map"].shape == file["grid"].shape == (208, 272, 2)
        assert file["matchability"].shape == (208, 272)
        assert np.isfinite(file["map"]).all()
        # The grid's corners are the centres of cells of 320/272 by 240/208 pixels.
        corner = [320 / 544 - 0.5, 240 / 416 - 0.5]
        assert file["grid"][0, 0] == pytest.approx(corner, abs=1e-4)
        assert file["grid"][-1, -1] == pytest.approx(np.subtract([319, 239], corner), abs=1e-4)


@pytest.mark.parametrize("refine, error", [("none", (0.5, 1.5)), ("map", (0.0, 0.1))])
def test_matches_written_are_refined_and_the_map_is_not(network, refine, error):
    network(OFF)
    result = match("--refine", refine)
    assert result.exit_code == 0, result.stderr
    with np.load("m.npz", allow_pickle=False) as file:
        assert np.array_equal(file["map"], OFF.map)
        off = dense_scene.points_in_image1(file["points2"]) - file["points1"]
    assert error[0] < np.median(np.linalg.norm(off, axis=1)) < error[1]


def test_an_orientation_that_is_not_applied_is_told(network):
    network(TRUE)
    exif = PIL.Image.Exif()
    exif[0x0112] = 8
    with PIL.Image.open("two.png") as image:
        image.save("two.png", exif=exif)
    result = match("--refine", "none")
    assert result.stderr.count("two.png: EXIF orientation 8 is not applied") == 1
    assert "one.png" not in result.stderr
