"""The page of a model: what it holds, and what a browser shows of it."""

import base64
import importlib
import io
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
from PIL import Image
from results import ambiguous_pose
from scipy.spatial import cKDTree
from worlds import CAMERA, IMAGE, world_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ImageError, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import load_image
from dgc_pose.model import Model
from dgc_pose.pose import solve_pair
from dgc_pose.viz import model_page, pose_page

# Of the upper left, the upper right, the lower right and the lower left quarter of a photograph.
QUARTERS = {"red": (255, 0, 0), "green": (0, 255, 0), "blue": (0, 0, 255), "yellow": (255, 255, 0)}
# The mean place and the number of a canvas's pixels near a colour.
PLACE = """((colour) => {
  const canvas = document.querySelector('canvas');
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  let [x, y, count] = [0, 0, 0];
  for (let n = 0; n < data.length; n += 4) {
    if (!data[n + 3] || colour.some((value, k) => Math.abs(value - data[n + k]) > 40)) continue;
    [x, y, count] = [x + n / 4 % canvas.width, y + Math.floor(n / 4 / canvas.width), count + 1];
  }
  return [x / count, y / count, count];
})"""


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Model:
    """Five cameras, each with a photograph of four colours."""
    root = tmp_path_factory.mktemp("<photos>")
    red, green, blue, yellow = QUARTERS.values()
    picture = np.array([[red, green], [yellow, blue]], np.uint8).repeat(400, 0).repeat(500, 1)
    for name in world_scene().names:
        cv2.imwrite(str(root / name), picture[..., ::-1])
    return replace(world_scene().model(), root=root)


@pytest.fixture(scope="module")
def rig(model, tmp_path_factory) -> tuple[Model, Path]:
    """A model whose r2 and r4 are the fixed cameras "north" and "a.b", the second with a black
    picture, and the folder of their pictures. A photograph of the walk is a "north.jpg" too."""
    root = tmp_path_factory.mktemp("rig")
    moved = {"r0.jpg": "walk/north.jpg", "r2.jpg": "out/cameras/north.jpg"}
    moved |= {"r4.jpg": "out/cameras/a.b.jpg"}
    for name in model.poses:
        path = root / moved.get(name, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(model.root / name, path)
    cv2.imwrite(str(path), np.zeros((*IMAGE[::-1], 3), np.uint8))
    poses = {moved.get(name, name): pose for name, pose in model.poses.items()}
    return Model(root, dict.fromkeys(poses, CAMERA), poses), root / "out" / "cameras"


def page_of(model: Model, unit: str = "", rejected=(), cameras: Path | None = None) -> str:
    points = world_scene().points
    colours = np.full(points.shape, 128, np.uint8)
    coloured = replace(model, points=points, colours=colours)
    return model_page(coloured, unit, rejected, cameras)


def photograph_of(camera: dict) -> Image.Image:
    encoded = camera["photograph"].removeprefix("data:image/jpeg;base64,")
    return Image.open(io.BytesIO(base64.b64decode(encoded)))


def content_of(page: str) -> dict:
    return json.loads(re.search(r"^const content = (.*);$", page, re.MULTILINE)[1])


def test_the_page_is_one_file_with_all_cameras(model):
    page = page_of(model, "m", rejected=[("r1.jpg", "r3.jpg"), ("r0.jpg", "elsewhere.jpg")])
    assert not re.search(
        r"https?:|@import|url\(|^import |^export | (src|href)=", page, re.MULTILINE
    )
    assert page.count("<script") == page.count("<canvas") == 1 and "{{" not in page
    facts = "5 cameras, 300 points; dashed: 1 pair rejected as look-alikes"
    assert f"{facts}; cameras up to {model.extent:.3g} m apart</p>" in page
    content = content_of(page)
    assert content["rejected"] == [[1, 3]]
    assert [camera["label"] for camera in content["cameras"]] == ["r0", "r1", "r2", "r3", "r4"]
    for name, camera in zip(sorted(model.poses), content["cameras"], strict=True):
        assert photograph_of(camera).size == (960, 768)
        centre = ", ".join(f"{value:.4g}" for value in model.centre(name))
        assert camera["facts"] == f"centre ({centre}) m, f = 902.5 px, 1000 x 800 pixels"


def test_a_rig_has_fixed_cameras_and_a_walk(rig):
    model, pictures = rig
    page = page_of(model, "m", cameras=pictures)
    assert "<h1>a.b, north</h1>" in page
    one, two = (model.centre(f"out/cameras/{name}.jpg") for name in ("north", "a.b"))
    apart = f"cameras up to {np.linalg.norm(one - two):.3g} m apart"
    assert f"<p>2 fixed cameras, a walk of 3, 300 points; {apart}</p>" in page
    kinds = {"fixed": {}, "walk": {}}
    for camera in content_of(page)["cameras"]:
        centre, *corners = np.array(camera["corners"])
        kinds[camera["kind"]][camera["label"]] = np.linalg.norm(corners - centre, axis=1)
    assert {kind: [*cameras] for kind, cameras in kinds.items()} == {
        "fixed": ["a.b", "north"],
        "walk": ["r1", "r3", "north"],
    }
    assert max(map(np.max, kinds["walk"].values())) < min(map(np.min, kinds["fixed"].values())) / 2
    alone = page_of(model, cameras=pictures.parent)
    assert not any("kind" in camera for camera in content_of(alone)["cameras"])


def test_many_photographs_are_small(model, rig, monkeypatch):
    """But not those of fixed cameras."""
    module = importlib.import_module("dgc_pose.viz.model_page")  # the package has its function
    monkeypatch.setattr(module, "_PIXELS", 5 * 400**2)
    shown = content_of(page_of(model))["cameras"]
    assert {photograph_of(camera).size for camera in shown} == {(400, 320)}
    monkeypatch.setattr(module, "_PIXELS", 1)
    shown = content_of(page_of(rig[0], cameras=rig[1]))["cameras"]
    sizes = {(camera["kind"], photograph_of(camera).size) for camera in shown}
    assert sizes == {("fixed", (960, 768)), ("walk", (160, 128))}


def test_names_of_any_bytes_are_text(model, tmp_path):
    """A byte that is no UTF-8, as Python decodes names of files, and what HTML would read."""
    root, names = tmp_path / "\udcff<b>", ("<script>\udcff.jpg", "r1.jpg")
    root.mkdir()
    poses = dict(zip(names, model.poses.values(), strict=False))
    with pytest.raises(ImageError, match="<script>"):
        page_of(Model(root, dict.fromkeys(poses, CAMERA), poses))
    for name in names:
        shutil.copy(model.root / "r0.jpg", root / name)
    page = page_of(Model(root, dict.fromkeys(poses, CAMERA), poses))
    (tmp_path / "model.html").write_text(page, encoding="utf-8")
    assert page.count("<script") == 1 and "<b>" not in page
    assert content_of(page)["cameras"][0]["label"] == "<script>\udcff"


def test_the_cameras_and_points_are_the_models(model):
    """Distances are kept, and each camera sees its corners at those of its image."""
    content = content_of(page_of(model))
    corners = np.array([camera["corners"] for camera in content["cameras"]])
    centres = np.stack([model.centre(name) for name in sorted(model.poses)])
    shown = corners[:, 0]
    gaps, true = (np.linalg.norm(c[:, None] - c, axis=-1) for c in (shown, centres))
    np.testing.assert_allclose(gaps, true, atol=1e-3)
    pixels = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * IMAGE - 0.5
    rays = np.column_stack([pixels, np.ones(4)]) @ np.linalg.inv(CAMERA.K).T
    for pyramid in corners - shown[:, None]:
        scale = np.linalg.norm(pyramid[1]) / np.linalg.norm(rays[0])
        np.testing.assert_allclose(pyramid[1:] @ pyramid[1:].T, scale**2 * rays @ rays.T, atol=1e-3)
    # Whoever looks as the mean camera does has the scene ahead and upright.
    mean = np.mean(corners[:, 1:] - shown[:, None], axis=0)
    assert (mean[:, 2] > 0).all() and (np.sign(mean[:, :2]) == np.sign(rays[:, :2])).all()
    points = np.array(content["points"]["xyz"])
    assert 0.96 * 300 < len(points) < 300 and (points[:, 2] > shown[:, 2].max()).all()


def test_a_pair_is_shown_in_camera_1s_axes():
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    matcher, options = dense_scene.MapMatcher(dense_scene.true_map()), EstimationOptions(runs=1)
    images = map(load_image, dense_scene.pictures())
    result = solve_pair(*images, (camera, camera), matcher, options)
    content = content_of(pose_page(result))
    first, second = (np.array(camera["corners"]) for camera in content["cameras"])
    points = np.array(content["points"]["xyz"])
    away, nearest = cKDTree(result.points3d).query(points)
    assert len(points) > 100 and away.max() < 1e-2
    rows = np.array(content["points"]["rgb"]).reshape(-1, 3)
    np.testing.assert_array_equal(rows, result.colours[nearest])
    assert (first[0] == 0).all()
    width, height = dense_scene.SIZE
    pixels = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    for corners in (first[1:], second[1:] @ result.pose.R.T + result.pose.t):
        seen = corners @ dense_scene.K.T
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], pixels, atol=0.5)
    with pytest.raises(InputError, match="result has no R and t"):
        pose_page(replace(result, pose=ambiguous_pose()))


@pytest.mark.slow
def test_a_browser_shows_the_photographs_upright(browser, model, tmp_path):
    path = tmp_path / "model.html"
    path.write_text(page_of(model), encoding="utf-8")
    browser.open_anew(path.as_uri())
    browser.wait("document.querySelector('canvas').height > 200")
    browser.click("#names")
    browser.click("[data-from=behind]")
    at = {name: f"{PLACE}({list(rgb)})" for name, rgb in QUARTERS.items()}
    place = {name: browser.evaluate(code) for name, code in at.items()}
    assert min(count for _, _, count in place.values()) > 300
    for left, right in (("red", "green"), ("yellow", "blue")):
        assert place[left][0] + 5 < place[right][0]
    for upper, lower in (("red", "yellow"), ("green", "blue")):
        assert place[upper][1] + 5 < place[lower][1]
    assert browser.errors == []


@pytest.mark.slow
def test_a_camera_opens_its_picture(browser, rig, tmp_path):
    """By the mouse, a finger and the keyboard; not by a drag, which rotates."""
    model, pictures = rig
    path = tmp_path / "model.html"
    path.write_text(page_of(model, cameras=pictures), encoding="utf-8")
    browser.open_anew(path.as_uri())
    browser.wait("document.querySelector('canvas').children.length === 5")
    left, top = browser.evaluate(
        "(({ left, top }) => [left, top])(document.querySelector('canvas').getBoundingClientRect())"
    )
    x, y, count = browser.evaluate(f"{PLACE}({list(QUARTERS['red'])})")
    assert count > 100
    place = (left + x, top + y)
    opened = "document.querySelector('dialog').open"
    for open_it in (lambda: browser.drag(place), lambda: browser.tap(*place)):
        open_it()
        browser.wait(opened)
        facts = browser.evaluate("document.querySelector('figcaption').textContent")
        assert facts.startswith("northcentre (") and facts.endswith(
            "f = 902.5 px, 1000 x 800 pixels"
        )
        assert browser.evaluate("document.querySelector('dialog img').naturalWidth") == 960
        browser.press("Escape")
        browser.wait(f"!{opened}")
    browser.drag(place, (place[0] + 40, place[1]), place)
    browser.evaluate("document.querySelector('canvas').focus()")
    assert not browser.evaluate(opened)
    browser.press("Tab", "Tab", "Enter")
    browser.wait(opened)
    assert browser.text("#whose") == "north"
    assert browser.errors == []
