"""What the page draws, and how it fits into the window."""

import json
import re

import dense_scene
import numpy as np
import pytest

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
