"""`dgc-pose locate` on rendered views of known poses, with the shipped network."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from bad_pictures import BAD_PICTURES, write_bad_pictures
from command_line import assert_all_bad, assert_refused, run
from worlds import SIZE, K, K_text, View, render_views, write_views

from dgc_pose.cameras.camera import Camera
from dgc_pose.cli.locate import location_text
from dgc_pose.estimation.status import percent_text
from dgc_pose.geometry.rotation import quaternion_wxyz
from dgc_pose.images.image import load_image
from dgc_pose.localization.location import Location
from dgc_pose.metrics import rotation_error_deg

PHOTO = 1  # of the views
FAST = ("--effort", "fast", "--runs", "2", "--iterations", "200")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[View]]:
    """A folder with images/, the poses of all but one in poses.csv, and that one as photo.png."""
    folder = tmp_path_factory.mktemp("scene")
    views = render_views(3, step=0.5)
    names = write_views(folder / "images", views)
    (folder / "images" / names[PHOTO]).rename(folder / "photo.png")
    lines = ["name,qw,qx,qy,qz,tx,ty,tz,fx,fy,cx,cy"]
    for name, view in zip(names, views, strict=True):
        values = [*quaternion_wxyz(view.R), *view.t, K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        lines.append(",".join([name, *map(str, values)]))
    del lines[1 + PHOTO]
    (folder / "poses.csv").write_text("\n".join(lines))
    return folder, views


def locate(folder: Path, *words: object, photo: object = "photo.png"):
    model = ("--model", folder / "poses.csv", "--images", folder / "images")
    return run("locate", folder / str(photo), *model, *FAST, *words)


def test_a_photograph_is_placed(scene: tuple[Path, list[View]], tmp_path: Path) -> None:
    folder, views = scene
    out = tmp_path / "out"
    out.mkdir()
    files = ("--json", out / "o.json", "--plot", out / "o.png", "--add", out / "model")
    result = locate(folder, "--K", K_text(), *files)
    assert result.exit_code == 0, result.output
    (data,) = json.loads((out / "o.json").read_text()).values()
    true = views[PHOTO]
    assert data["status"] == "located" and data["probability"] > 0.9
    assert rotation_error_deg(np.array(data["R"]), true.R) < 0.5
    assert np.linalg.norm(np.array(data["centre"]) - true.centre) < 0.05
    np.testing.assert_allclose(-np.array(data["R"]).T @ data["t"], data["centre"], atol=1e-9)
    assert data["rotation_error_90_deg"] < 2 and data["position_error_90"] < 0.3
    assert sum(reference["agrees"] for reference in data["references"]) > 1
    assert f"probability {percent_text(data['probability'])}" in result.stdout
    assert load_image(out / "o.png").size[0] > 1000
    added = pycolmap.Reconstruction(out / "model").find_image_with_name("photo.png")
    assert added is not None
    np.testing.assert_allclose(added.cam_from_world().matrix()[:, 3], data["t"], atol=1e-9)
    itself = ("--model", out / "model", "--add", out / "model", "--overwrite")
    assert_refused(locate(folder, *itself), "--add", "model is the model itself")


def test_an_image_of_the_model_is_not_matched_and_another_place_is_nowhere(
    scene: tuple[Path, list[View]],
) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    other = cv2.resize(noise, (240, 180), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(scene[0] / "other.png"), other)
    inside = locate(scene[0], "--K", K_text(), "--json", "-", photo="images/view2.png")
    (data,) = json.loads(inside.stdout).values()
    said = "is in the model as view2.png, which is not matched"
    assert any(said in warning for warning in data["warnings"])
    assert "view2.png" not in {reference["name"] for reference in data["references"]}
    result = locate(scene[0], "--K", K_text(), photo="other.png")
    assert result.exit_code == 3
    assert "nowhere, none of 2 database images has a likely pose" in result.stdout


def test_bad_queries_are_named_and_the_others_located(
    scene: tuple[Path, list[View]], tmp_path: Path
) -> None:
    """Also one that K does not fit. --json is written even if no query can be read."""
    bad = write_bad_pictures(tmp_path / "bad")
    half = tmp_path / "half.png"
    cv2.imwrite(str(half), cv2.imread(str(scene[0] / "photo.png"))[:80])
    out = tmp_path / "o.json"
    result = locate(scene[0], *bad, half, "--K", K_text(), "--json", out)
    assert result.exit_code == 3, result.output
    located, *others = json.loads(out.read_text()).values()
    assert located["status"] == "located" and "photo.png: cam_from_world" in result.stdout
    lines = result.stderr.splitlines()
    reasons = [*BAD_PICTURES.values(), "outside the image"]
    assert len(lines) == len(others) == len(reasons)
    for path, line, data, reason in zip([*bad, half], lines, others, reasons, strict=True):
        assert line.startswith(f"bad image {path}") and reason in line
        assert data["status"] == "bad_input" and reason in data["warnings"][0]
        assert data["R"] is None and data["references"] == []
    words = (bad[1], "--json", tmp_path / "none.json", "--add", tmp_path / "with")
    refused = locate(scene[0], *words, photo=bad[0])
    assert_all_bad(refused, f"{bad[0]} cannot be decoded", f"{bad[1]} is corrupt")
    assert len(json.loads((tmp_path / "none.json").read_text())) == 2
    assert not (tmp_path / "with").exists()
    on_stdout = locate(scene[0], "--json", "-", "--plot", tmp_path / "o.png", photo=bad[0])
    assert on_stdout.exit_code == 2 and len(json.loads(on_stdout.stdout)) == 1
    (line,) = on_stdout.stderr.splitlines()
    assert line.startswith(f"error: {bad[0]} cannot be decoded")
    assert not (tmp_path / "o.png").exists()


def test_a_fitted_camera_is_told() -> None:
    stds = {"focal_std": 0.01, "centre_std": 2.0, "aspect_std": 0.004}
    camera = Camera(K, SIZE, focal_source="matches", **stds)
    location = Location("located", "", (), np.eye(3), np.zeros(3), camera=camera)
    told = (
        "camera: f = 225.8 +- 2.3 px by the matches; fy / fx 1.007 +- 0.004; "
        "principal point (121.0, 87.5) +- 2.0"
    )
    assert told in location_text("query.jpg", location).splitlines()
    exact = replace(location, camera=camera.as_exact())
    assert "camera" not in location_text("query.jpg", exact).replace("cam_from_world", "")
