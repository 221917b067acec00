"""What the page draws, and how it fits into the window."""

import json
import re

import cv2
import dense_scene
import numpy as np
import pytest

from dgc_pose.geometry.epipolar import essential_from_pose, fundamental_from_essential

pytestmark = pytest.mark.slow

# Elements that do not lie within the window, or none.
OUTSIDE = """[document.scrollingElement, ...document.querySelectorAll('body *')].filter((part) => {
  const { left, right, width } = part.getBoundingClientRect();
  return width && (left < -0.5 || right > innerWidth + 0.5);
}).map((part) => part.outerHTML.slice(0, 100))"""


@pytest.mark.parametrize("width", [360, 390, 768, 1280])
def test_everything_fits_into_the_window(map_page, width):
    page = map_page
    try:
        page.resize(width, 900)
        for kind in ("auto", "k", "file", "fov"):
            page.click(f"[value={kind}]")
            assert page.evaluate(OUTSIDE) == []
            assert page.evaluate("document.scrollingElement.scrollWidth") <= width
    finally:
        page.resize(1400, 1600)


def pointed(page):
    """The pixel under the pointer, and that of the map in the other image, as the page says."""
    page.wait("document.querySelector('#pointed').textContent.includes('by the map')")
    numbers = re.findall(r"image ([12]) \(([-.\d]+), ([-.\d]+)\)", page.text("#pointed"))
    return [(int(image), np.array([float(x), float(y)])) for image, x, y in numbers[:2]]


def clear(page):
    page.evaluate("document.querySelector('#view').focus()")
    page.press("Escape")


@pytest.mark.parametrize("way", ["hover", "touch"])
@pytest.mark.parametrize("place", [(0.25, 0.5), (0.3, 0.4), (0.7, 0.6), (0.8, 0.3)])
def test_the_maps_point_stands_in_the_other_image(map_page, way, place):
    clear(map_page)
    before = map_page.drawn("#view")
    getattr(map_page, way)("#view", place)
    map_page.redrawn("#view", before)
    (image, at), (other, there) = pointed(map_page)
    assert {image, other} == {1, 2} and image == (1 if place[0] < 0.5 else 2)
    x1, x2 = (at, there) if image == 1 else (there, at)
    # The server rounds to 0.1 pixels, and its map has an error of 0.2.
    np.testing.assert_allclose(dense_scene.points_in_image1(x2), x1, atol=1.2)
    distance = re.search(r"([.\d]+) px from the epipolar line", map_page.text("#pointed"))
    assert distance is not None and float(distance[1]) < 1.2


def test_the_arrows_cross_from_image_to_image(map_page):
    clear(map_page)
    seen = []
    steps = (("Right", 20), ("Right", 60), ("Right", 150), ("Left", 60), ("Left", 150))
    for key, times in steps:
        for _ in range(times):
            map_page.press(f"Arrow{key}")
        seen.append(map_page.text("#pointed")[:7])
    assert seen == ["image 1", "image 2", "image 2", "image 2", "image 1"]


# A view of two images of one colour, without the page: result, canvas width, and its height.
VIEW = """import('/static/view.js').then(({ View }) => {
  const canvas = document.createElement('canvas');
  document.body.replaceChildren(canvas);
  canvas.style.width = '%(width)dpx';
  const view = new View(canvas, document.createElement('p'));
  const result = %(result)s;
  const images = result.sizes.map(([width, height]) => {
    const image = Object.assign(document.createElement('canvas'), { width, height });
    image.getContext('2d').fillStyle = '%(colour)s';
    image.getContext('2d').fillRect(0, 0, width, height);
    return image;
  });
  view.show(result, ...images);
  view.options = { count: 10, lines: true, outliers: false, epipolar: true };
  view.draw();
  return %(asked)s;
})"""


def viewed(page, asked, sizes, width=700, colour="#fff", F=None, points=()):
    matches = {"points": list(points), "inlier": [False] * len(points)}
    matches |= {name: [None] * len(points) for name in ("residual", "confidence")}
    result = json.dumps({"sizes": sizes, "F": F, "matches": matches, "correspondences": None})
    values = {"width": width, "result": result, "colour": colour, "asked": asked}
    return page.evaluate(VIEW % values)


LANDSCAPE, PORTRAIT, WIDE = [1280, 960], [960, 1280], [3000, 500]


@pytest.mark.parametrize(("width", "tall"), [(348, 844), (700, 1024), (1160, 900)])
@pytest.mark.parametrize(
    "sizes", [[PORTRAIT, PORTRAIT], [LANDSCAPE, PORTRAIT], [LANDSCAPE, LANDSCAPE], [WIDE, PORTRAIT]]
)
def test_photographs_get_the_room_there_is(page, sizes, width, tall):
    try:
        page.resize(width + 50, tall)
        first, second = viewed(page, "view.places", sizes, width)
    finally:
        page.resize(1400, 1600)
    for place, (w, h) in zip((first, second), sizes, strict=True):
        assert place["width"] / w == pytest.approx(place["scale"])
        assert place["height"] / h == pytest.approx(place["scale"])
        assert place["left"] >= -1e-6 and place["left"] + place["width"] <= width + 1e-6
    beside = second["top"] == 0
    start, size = ("left", "width") if beside else ("top", "height")
    assert second[start] - first[start] - first[size] == pytest.approx(8)
    bottom = second["top"] + second["height"]
    assert bottom <= 0.85 * tall + 1e-6
    # Either the width or the height is used up, and two portraits on a telephone are no stamps.
    span = second["left"] + second["width"] - first["left"] if beside else first["width"]
    assert span == pytest.approx(width) or bottom == pytest.approx(0.85 * tall)
    if sizes == [PORTRAIT, PORTRAIT]:
        assert first["height"] > 0.35 * tall


@pytest.mark.parametrize("portrait", [True, False])
@pytest.mark.parametrize("width", [390, 768, 1280])
def test_a_photograph_to_send_is_seen_whole(page, tmp_path, width, portrait):
    pixels = dense_scene.pictures()[0].repeat(2, axis=0).repeat(2, axis=1)
    cv2.imwrite(str(tmp_path / "a.png"), np.rot90(pixels) if portrait else pixels)
    try:
        page.resize(width, 844)
        page.choose("#file1", tmp_path / "a.png")
        page.wait("document.querySelector('#picture1').naturalWidth > 0")
        boxes = page.evaluate(
            "['#picture1', '#drop1'].map((name) => { const box ="
            " document.querySelector(name).getBoundingClientRect();"
            " return [box.left, box.top, box.right, box.bottom]; })"
        )
    finally:
        page.resize(1400, 1600)
    (left, top, right, bottom), zone = boxes
    assert zone[0] <= left and zone[1] <= top and right <= zone[2] and bottom <= zone[3]
    wide, high = right - left, bottom - top
    assert wide / high == pytest.approx(3 / 4 if portrait else 4 / 3, abs=0.02)
    # As large as others, or as wide as the place.
    assert max(wide, high) == pytest.approx(346) or wide == pytest.approx(zone[2] - zone[0] - 4)


@pytest.mark.parametrize("colour", ["#fff", "#000", "#d5dbe1"])
def test_matches_without_a_pose_are_seen_on_any_photograph(page, colour):
    level = (
        "Array.from(canvas.getContext('2d').getImageData(100, 40, 1, 60).data)"
        ".filter((value, n) => n % 4 === 1)"
    )
    points = [[0, 150, 400, 150]]
    levels = np.array(viewed(page, level, [LANDSCAPE, LANDSCAPE], 700, colour, points=points))
    around = levels[0]
    assert np.abs(levels - around).max() > 80


def test_both_lines_of_a_pixel_are_of_one_epipolar_plane(page):
    E = essential_from_pose(dense_scene.R, dense_scene.T)
    F = fundamental_from_essential(E, dense_scene.K, dense_scene.K)
    sizes = [dense_scene.SIZE, dense_scene.SIZE]
    for image, pixel in ((0, [40.0, 70.0, 1.0]), (1, [200.0, 30.0, 1.0])):
        pointer = json.dumps([image, *pixel[:2]])
        asked = f"Object.assign(view, {{ pointer: {pointer} }}).epipolarLines()"
        own, other = map(np.array, viewed(page, asked, sizes, F=(F / np.abs(F).max()).tolist()))
        matrix = F if image == 0 else F.T
        expected = matrix @ pixel
        np.testing.assert_allclose(other / other[1], expected / expected[1])
        # Through the pixel and the epipole, which the matrix takes to 0.
        epipole = np.linalg.svd(matrix)[2][2]
        line = np.cross(pixel, epipole)
        np.testing.assert_allclose(own / own[1], line / line[1], rtol=1e-6)


def test_the_scene_projects_points_as_a_camera_behind_camera_1_does(map_page):
    """From behind, with the eye far off, points lie to the right of each other by x, below by y."""
    places = map_page.evaluate(
        "import('/static/scene.js').then(({ Scene }) => {"
        " const scene = new Scene(document.createElement('canvas'));"
        " Object.assign(scene, { middle: [1, 2, 3], radius: 2, azimuth: 0, elevation: 0 });"
        " const seen = scene.projection(100, 50, 10);"
        " return [[1, 2, 3], [2, 2, 3], [1, 3, 3], [2, 2, 5]].map(seen); })"
    )
    expected = [[100, 50, 5.2], [100 + 10 / 5.2, 50, 5.2], [100, 50 + 10 / 5.2, 5.2]]
    np.testing.assert_allclose(places[:3], expected)
    np.testing.assert_allclose(places[3], [100 + 10 / 7.2, 50, 7.2])


def test_a_key_turns_the_scene_of_a_pair(map_page):
    before = map_page.drawn("#scene")
    map_page.evaluate("document.querySelector('#scene').focus()")
    map_page.press("ArrowLeft")
    turned = map_page.redrawn("#scene", before)
    map_page.click("[data-from=aslant]")  # as at first
    assert map_page.redrawn("#scene", turned) == before


def test_a_result_is_saved_as_json_and_png(map_page):
    page = map_page
    page.evaluate(
        "(() => { window.saved = []; URL.createObjectURL = (blob) => { saved.push(blob);"
        " return 'data:,'; }; HTMLAnchorElement.prototype.click = function () {"
        " this.download && saved.push(this.download); }; })()"
    )
    page.click("#save-json")
    page.click("#save-png")
    page.wait("saved.length === 4")
    names = "saved.filter((part) => typeof part === 'string')"
    assert page.evaluate(names) == ["pose.json", "pose.png"]
    data = json.loads(page.evaluate("saved[0].text()"))
    assert data["status"] == "ok" and len(data["matches"]["points"]) > 100
    assert page.evaluate("saved[2].type") == "image/png"
