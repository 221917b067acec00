import dense_scene
import numpy as np
import PIL.Image
import pytest
from command_line import run

TRUE, OFF = dense_scene.true_map(), dense_scene.true_map(error_px=0.7)


@pytest.fixture
def network(tmp_path, monkeypatch):
    """Pictures in the working folder; makes every network's map this one."""
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pictures(tmp_path)

    def use(correspondence_map):
        dense_scene.replace_network(monkeypatch, lambda weights: correspondence_map)

    return use


def match(*arguments):
    return run("match", "one.png", "two.png", "--out", "m.npz", *arguments)


def test_map_and_matches_are_written(network):
    network(TRUE)
    exif = PIL.Image.Exif()
    exif[0x0112] = 8
    with PIL.Image.open("two.png") as image:
        image.save("two.png", exif=exif)
    result = match("--refine", "none", "--max-matches", "300")
    assert result.exit_code == 0
    with np.load("m.npz", allow_pickle=False) as file:
        assert sorted(file) == ["confidence", "grid", "map", "matchability", "points1", "points2"]
        for name in ("map", "grid", "matchability"):
            assert np.array_equal(file[name], getattr(TRUE, name))
        count = len(file["confidence"])
        assert 0 < count <= 300
        assert file["points1"].shape == file["points2"].shape == (count, 2)
        off = dense_scene.points_in_image1(file["points2"]) - file["points1"]
        assert np.abs(off).max() < 1e-3
    assert f"{count} matches of {dense_scene.CELLS**2} cells" in result.stdout
    assert result.stderr.count("two.png: EXIF orientation 8 is applied") == 1
    assert "one.png" not in result.stderr
