import json
import os

import cv2
import dense_scene
import numpy as np
import pytest
from command_line import assert_refused, run
from results import ambiguous_pose

from dgc_pose.metrics import rotation_error_deg, translation_error_deg

KEYS = """status success R t length length_std quaternion_wxyz E camera1 camera2 num_matches
    num_inliers inlier_ratio median_triangulation_angle_deg rotation_error_90_deg
    translation_error_90_deg covariance probability any_probability same_place_probability
    tested_matchers alternatives warnings seconds""".split()
# Later ones override these.
FAST = ("--runs", "1", "--iterations", "200", "--max-matches", "1000", "--refine", "none")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two pictures, one.png and two.png, in the working directory."""
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pictures(tmp_path)
    return tmp_path


@pytest.fixture
def network(monkeypatch):
    """Replaces the network by a map; returns the function that chooses the map."""

    def use(dense):
        dense_scene.replace_network(monkeypatch, lambda weights: dense)

    use(dense_scene.true_map())
    return use


def estimate(*arguments, k=("--K", dense_scene.K_TEXT)):
    return run("estimate", "one.png", "two.png", *k, *FAST, *arguments)


def test_all_outputs_are_written_and_json_has_the_pose(folder, network):
    files = ("--json", "p.json", "--matches", "m.npz", "--plot", "p.png", "--map", "map.npz")
    result = estimate(*files, "--baseline", 3)
    assert result.exit_code == 0 and "cam2_from_cam1" in result.stdout
    assert sorted(os.listdir(folder)) == sorted([*files[1::2], "one.png", "two.png"])
    data = json.loads((folder / "p.json").read_text())
    assert list(data) == KEYS
    assert data["status"] == "ok" and data["success"] is True and data["warnings"] == []
    assert data["length"] == pytest.approx(3)
    assert rotation_error_deg(np.array(data["R"]), dense_scene.R) < 0.05
    assert translation_error_deg(np.array(data["t"]), dense_scene.T) < 0.2
    for camera in (data["camera1"], data["camera2"]):
        assert np.allclose(camera["K"], dense_scene.K)
        assert camera["focal_std"] == 0 and camera["focal_source"] == "given"
    with np.load("m.npz", allow_pickle=False) as file:
        points = {"confidence", "inliers", "points1", "points2"}
        assert {*file} == points | {"error_px", "key_points", "image1", "image2", "weights"}
        assert (file["image1"], file["image2"]) == ("one.png", "two.png")
        assert file["points1"].shape == file["points2"].shape == (data["num_matches"], 2)
        assert file["confidence"].shape == (data["num_matches"],)
        assert file["inliers"].dtype == bool and file["inliers"].sum() == data["num_inliers"]
        off = dense_scene.points_in_image1(file["points2"]) - file["points1"]
        assert np.abs(off).max() < 1e-3
    with np.load("map.npz", allow_pickle=False) as file:
        assert sorted(file) == ["grid", "map", "matchability"]
        for name in file:
            assert np.array_equal(file[name], getattr(dense_scene.true_map(), name))
    picture = cv2.imread("p.png")
    assert picture.shape[1] == 2000 and picture.std() > 10


def test_points_with_colours_are_in_metres_by_a_depth_map(folder, network):
    """A depth map of half the size of the image; |t| of the scene is 1. Where camera 2 sees the
    points, the true map leads to camera 1's."""
    np.save("depth.npy", 2.5 * dense_scene.depth_in_camera2(dense_scene.grid(160, 120)))
    text = estimate("--depth2", "depth.npy", "--json", "p.json", "--ply", "points.ply").stdout
    data = json.loads((folder / "p.json").read_text())
    assert data["warnings"] == [] and np.linalg.norm(data["t"]) == pytest.approx(1)
    assert data["length"] == pytest.approx(2.5, rel=0.02) and data["length_std"] < 0.25
    told = f"(translation {data['length']:.4g} m +- {data['length_std']:.2g} m)"
    assert told in text and "up to scale" not in text
    header, content = (folder / "points.ply").read_bytes().split(b"end_header\n")
    vertices = np.frombuffer(content, [(a, "<f4") for a in "xyz"] + [(c, "u1") for c in "rgb"])
    assert f"element vertex {len(vertices)}\n".encode() in header and len(vertices) > 500
    points = np.stack([vertices[axis] for axis in "xyz"], axis=1) / data["length"]
    colours = np.stack([vertices[colour] for colour in "rgb"], axis=1)
    moved = points @ dense_scene.R.T + dense_scene.T
    pixels1, pixels2 = (
        300 * part[:, :2] / part[:, 2:] + dense_scene.K[:2, 2] for part in (points, moved)
    )
    assert np.abs(dense_scene.points_in_image1(pixels2) - pixels1).max() < 0.5
    x, y = np.rint(pixels1).astype(int).T
    same = (colours == dense_scene.pictures()[0][y, x]).all(axis=1)
    assert same.mean() > 0.99  # but for points half-way between two pixels


def test_noise_has_no_pose(folder, network):
    network(dense_scene.noise_map())
    result = estimate("--json", "-", "--plot", "p.png", "--ply", "p.ply")
    assert result.exit_code == 3
    data = json.loads(result.stdout)
    assert list(data) == KEYS
    assert data["success"] is False and data["status"] != "ok"
    assert data["R"] is None and data["t"] is None and data["quaternion_wxyz"] is None
    assert data["warnings"], "the reason must be told"
    assert result.stderr == f"no pose: {data['warnings'][0]}\n"
    assert sorted(os.listdir(folder)) == ["one.png", "p.ply", "p.png", "two.png"]
    assert b"element vertex 0\n" in (folder / "p.ply").read_bytes()


def test_an_ambiguous_pair_exits_with_3_and_has_both_poses(folder, network, monkeypatch):
    monkeypatch.setattr("dgc_pose.pose.estimate_pose", lambda m, *_, **__: ambiguous_pose(len(m)))
    result = estimate("--json", "-", "--plot", "p.svg", "--matches", "m.npz")
    pose = ambiguous_pose()
    assert (result.exit_code, result.stderr) == (3, f"no pose: {pose.reason}\n")
    data = json.loads(result.stdout)
    assert data["status"] == "ambiguous" and data["R"] is None and data["t"] is None
    for stored, other in zip(data["alternatives"], pose.alternatives, strict=True):
        np.testing.assert_array_equal(stored["R"], other.R)
    assert (folder / "p.svg").exists() and (folder / "m.npz").exists()


def test_a_camera_that_is_not_stated_is_auto(folder, network):
    result = estimate("--json", "-", k=())
    said = "K is not stated: the focal length is estimated (--K auto)\n"
    assert (result.exit_code, result.stderr) == (0, said)
    stated = json.loads(estimate("--json", "-", k=("--K", "auto")).stdout)
    np.testing.assert_array_equal(json.loads(result.stdout)["R"], stated["R"])
    second = estimate("--json", "-", k=("--K2", dense_scene.K_TEXT))
    assert second.stderr == said.replace("K ", "K1 ").replace("--K ", "--K1 ")


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--weights", "sift", "--map", "m.npz"), "--map needs a dense map, and sift has none"),
        (("--baseline", "1m"), "--baseline must be METRES[,STD]"),
        (("--K", "300,300,159.5"), "--K"),
        (("--fov", "60"), "--fov and --K exclude each other"),
        (("--K", "nosuch.txt"), "nosuch.txt"),
        (("--plot", "p.txt"), "p.txt"),
        (("--matches", "p.json"), "same file"),
        (("--device", "cuda"), "cuda"),
    ],
)
def test_unusable_input_is_refused(folder, monkeypatch, arguments, words):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert_refused(estimate("--json", "p.json", *arguments), words)
    assert sorted(os.listdir(folder)) == ["one.png", "two.png"]


def test_masked_pixels_are_not_matched(folder, network):
    left = np.zeros((240, 320), np.uint8)
    left[:, 150:] = 255
    cv2.imwrite("left.png", left)
    cv2.imwrite("low.png", left[::2, ::2])
    estimate("--mask1", "left.png", "--mask2", "low.png", "--matches", "m.npz")
    with np.load("m.npz", allow_pickle=False) as file:
        x1, x2 = file["points1"][:, 0], file["points2"][:, 0]
    assert len(x1) > 100 and x1.min() > 149 and x2.min() > 149


@pytest.mark.parametrize(
    ("options", "is_told"),
    [((), True), (("--second", "none"), False), (("--effort", "fast"), False)],
)
def test_a_pair_without_a_pose_is_told_how_the_second_matcher_is_installed(
    tmp_path, options, is_told
):
    """Where it is not installed, and the steps include it."""
    noise = np.random.default_rng(0).integers(0, 256, (2, 120, 160, 3), dtype=np.uint8)
    paths = [tmp_path / f"{k}.png" for k in range(2)]
    for path, pixels in zip(paths, noise, strict=True):
        cv2.imwrite(str(path), pixels)
    result = run("estimate", *paths, "--K", "150,150,80,60", *options)
    assert result.exit_code == 3
    assert ("is not installed: pip install ./lightglue" in result.stderr) == is_told
    assert result.stderr.count("\n") == is_told
