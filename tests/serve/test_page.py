"""The page in a browser, as a user would use it."""

import json
import re
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
from results import ambiguous_pose

from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.matchers import load_matcher

pytestmark = pytest.mark.slow

DONE = "document.querySelector('#progress').textContent.startsWith('done')"
STALE = "document.querySelector('#result').classList.contains('stale')"
# Elements that do not lie within the window.
OUTSIDE = """[document.scrollingElement, ...document.querySelectorAll('body *')].filter((part) => {
  const { left, right, width } = part.getBoundingClientRect();
  return width && (left < -0.5 || right > innerWidth + 0.5);
}).map((part) => part.outerHTML.slice(0, 100))"""


def set_value(page, selector, value):
    page.evaluate(
        f"(() => {{ const e = document.querySelector('{selector}'); e.value = '{value}';"
        "e.dispatchEvent(new Event('input', { bubbles: true })); })()"
    )


def matrices(page):
    """Those of the poses that the page shows."""
    texts = page.evaluate("[...document.querySelectorAll('#poses table')].map((t) => t.innerText)")
    return [np.array([line.split() for line in text.splitlines()], float) for text in texts]


def assert_fits(page, widths):
    for width in widths:
        page.resize(width, 900)
        for kind in ("auto", "file", "fov", "k"):
            page.click(f"[value={kind}]")
            assert page.evaluate(OUTSIDE) == []
    page.resize(1400, 1600)


def test_a_pair_of_files_gives_its_pose(open_page, map_matcher, pictures, tmp_path):
    bad = tmp_path / "bad <b>.png"
    bad.write_bytes(b"not an image")
    with open_page(map_matcher, images=2) as page:
        page.choose("#file1", bad)
        page.wait("!document.querySelector('#error').hidden")
        page.errors.clear()  # the browser notes the refusal
        assert page.text("#error").startswith("bad <b>.png: the file is not an image of a known")
        page.click("[value=k]")
        set_value(page, "#k1", dense_scene.K_TEXT)
        page.choose("#file1", *map(Path, pictures))
        page.wait(DONE)
        assert page.evaluate("document.querySelector('#error').hidden")
        assert page.text("#verdict") == "A pose" and "expected error" in page.text("#numbers")
        R, t = matrices(page)
        np.testing.assert_allclose(R, dense_scene.R, atol=0.01)
        np.testing.assert_allclose(t[:, 0], dense_scene.T, atol=0.02)
        # The server's folders are none of the page's business.
        assert str(tmp_path) not in page.evaluate("document.documentElement.innerHTML")
        assert page.text("#command").startswith("dgc-pose estimate one.png two.png --K ")
        for place in ((0.25, 0.5), (0.7, 0.6)):
            assert_pointed(page, place)
        assert_fits(page, (360, 1280))
        set_value(page, "#k1", "310,310,159.5,119.5")
        assert page.evaluate(STALE) and "has changed" in page.text("#stale")
        # Another tab sends two images, which are all that this server keeps.
        page.choose("#kfile", Path(pictures[0]))
        page.evaluate(
            "(async () => { const token = document.querySelector('meta[name=token]').content;"
            "for (const name of ['a', 'b']) await fetch(`/images?name=${name}`, { method: 'POST',"
            " headers: { 'x-dgc-pose-token': token },"
            " body: await document.querySelector('#kfile').files[0].arrayBuffer() }); })()"
        )
        page.click("#estimate")
        page.wait(f"!{STALE}")
        assert "310.0 px" in page.text("#numbers")
        assert "410" in page.errors.pop()  # which the browser notes


def assert_pointed(page, place):
    """The map's point stands in the other image, on the epipolar line."""
    before = page.text("#pointed")
    page.hover("#view", place)
    page.wait(f"document.querySelector('#pointed').innerText !== {json.dumps(before)}")
    page.wait("document.querySelector('#pointed').textContent.includes('by the map')")
    numbers = re.findall(r"image ([12]) \(([-.\d]+), ([-.\d]+)\)", page.text("#pointed"))
    (image, at), (_, there) = [(int(n), np.array([float(x), float(y)])) for n, x, y in numbers[:2]]
    assert image == (1 if place[0] < 0.5 else 2)
    x1, x2 = (at, there) if image == 1 else (there, at)
    # The server rounds to 0.1 pixels, and its map has an error of 0.2.
    np.testing.assert_allclose(dense_scene.points_in_image1(x2), x1, atol=1.2)
    distance = re.search(r"([.\d]+) px from the epipolar line", page.text("#pointed"))
    assert distance is not None and float(distance[1]) < 1.2


def test_both_poses_of_an_ambiguous_pair_are_shown(open_page, map_matcher, monkeypatch):
    ambiguous = ambiguous_pose()

    def estimated(matches, *others, **more):
        return ambiguous_pose(len(matches))

    monkeypatch.setattr("dgc_pose.pose.estimate_pose", estimated)
    with open_page(map_matcher) as page:
        page.click("#example")
        page.wait(DONE)
        assert page.text("#verdict") == "Two poses explain these photographs"
        assert "do not show which of them is right" in page.text("#reason")
        assert "Pose 2: probability 45 %, 270 inliers" in page.text("#poses")
        shown = matrices(page)
        for R, t, pose in zip(shown[::2], shown[1::2], ambiguous.alternatives, strict=True):
            np.testing.assert_allclose(R, pose.R, atol=1e-6)
            np.testing.assert_allclose(t[:, 0], pose.t, atol=1e-6)
        # Nothing that is known of one pose alone.
        assert "probability" not in page.text("#numbers") and "K1" not in page.text("#numbers")
        assert page.text("#pointed").endswith("no pose, so there are no epipolar lines.")


ROWS = "[...document.querySelectorAll('#pairs tbody tr')]"
TEXTS = f"{ROWS}.map((row) => [...row.cells].map((cell) => cell.innerText.trim()))"


def test_a_folder_gives_a_table_of_its_pairs(open_page, tmp_path):
    """Of two photographs of a scene and one of another, among other files."""
    folder = tmp_path / "folder"
    (folder / "more").mkdir(parents=True)
    one, two = dense_scene.pictures()
    names = ("a1.png", "a2.png", "more/a10.png")
    for name, picture in zip(names, (one, two, dense_scene.pictures(seed=1)[0]), strict=True):
        cv2.imwrite(str(folder / name), picture[..., ::-1])
    (folder / "notes.txt").write_text("of another kind")
    with open_page(load_matcher("sift")) as page:
        page.click("[value=k]")
        set_value(page, "#k1", dense_scene.K_TEXT)
        page.drop("#drop2", folder)
        page.wait(
            "document.querySelector('#pairs-progress').textContent === '3 pairs, 1 with a pose'"
        )
        assert page.text("#taken") == "3 of 4 files are photographs by type or name; 3 are taken."
        first, *others = page.evaluate(TEXTS)
        assert first[:2] == ["a1.png, a2.png", "A pose"]
        angle = float(first[3].removesuffix("°"))
        assert angle == pytest.approx(rotation_angle_deg(dense_scene.R), abs=0.5)
        assert re.fullmatch(r"R within [\d.]+°, t within [\d.]+°", first[4])
        assert [row[0] for row in others] == ["a1.png, a10.png", "a2.png, a10.png"]
        for row in others:
            assert row[1].startswith("No pose\n") and row[2:5] == ["", "", ""]
        page.click("#pairs tbody tr:nth-child(1) button")
        page.wait(DONE)
        assert page.text("#verdict") == first[1]
        assert f"rotation angle\n{first[3]}\n" in page.text("#numbers")
        page.click("#pairs tbody tr:nth-child(2) button")
        page.wait("document.querySelector('#verdict').textContent === 'No pose'")
