"""The page in a browser, as a user would use it."""

import json
import re
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
from ambiguous_pose import ambiguous_pose
from serve_parts import DONE, estimate_rendered

from dgc_pose.cameras.pair_list import rendered_pair

pytestmark = pytest.mark.slow


def numbers(text):
    """Those of a matrix, as the page shows it."""
    return np.array([[float(cell) for cell in line.split()] for line in text.splitlines()])


def test_the_rendered_pair_gets_its_pose(rendered):
    assert rendered.text("#verdict") == "A pose"
    assert "inliers" in rendered.text("#numbers") and "expected error" in rendered.text("#numbers")
    pair = rendered_pair()
    R, t = (numbers(rendered.text(f"#poses table[aria-label={name}]")) for name in "Rt")
    np.testing.assert_allclose(R, pair.R, atol=0.01)
    np.testing.assert_allclose(t[:, 0], pair.t / np.linalg.norm(pair.t), atol=0.02)
    # The server's folders are none of the page's business.
    assert str(pair.path1.parent) not in rendered.evaluate("document.documentElement.innerHTML")
    assert rendered.text("#command").startswith("dgc-pose estimate image1.jpg image2.jpg --K1 ")
    assert "--weights sift" in rendered.text("#command")
    # A matcher of key points has no map.
    assert rendered.evaluate("document.querySelector('#map-part').hidden")


def test_the_bundled_photographs_are_taken_without_k(page):
    page.click("[value=k]")
    page.click("#example")
    page.wait(DONE)
    assert page.text("#verdict") == "A pose" and "K was not known" in page.text("#basis")
    assert page.text("#command").startswith("dgc-pose estimate image1.jpg image2.jpg --K auto ")
    assert page.text("#caption1") == "image1.jpg, 1280 x 960"
    expected = re.search(r"expected error\n(.*)", page.text("#numbers"))
    assert expected and expected[1].endswith(", nine times in ten if the pose is right")


# The answer with so much more.
CHANGED = """(() => {
  const asked = window.asked_of_the_server = window.fetch;
  window.fetch = async (path, ...rest) => {
    const answer = await asked(path, ...rest);
    if (path !== '/poses') return answer;
    const lines = (await answer.text()).split('\\n').map((line) => {
      const data = line && JSON.parse(line);
      const { pose, ...more } = %s;
      if (data.result) Object.assign(data.result, more).pose = { ...data.result.pose, ...pose };
      return line && JSON.stringify(data);
    });
    return new Response(lines.join('\\n'));
  };
})()"""


def test_both_poses_of_an_ambiguous_pair_are_shown(page):
    pose = ambiguous_pose().to_dict()
    changes = {"pose": pose, "reason": pose["warnings"][0], "F": None, "scene": None}
    page.evaluate(CHANGED % json.dumps(changes))
    estimate_rendered(page)
    assert page.text("#verdict") == "Two poses explain these photographs"
    assert "do not show which of them is right" in page.text("#reason")
    tables = "[...document.querySelectorAll('#poses %s')].map((part) => part.innerText)"
    captions = page.evaluate(tables % "figcaption")
    assert captions == [
        "Pose 1: probability 52 %, 271 inliers, rotation 28.65°",
        "Pose 2: probability 45 %, 270 inliers, rotation 18.12°",
    ]
    shown = list(map(numbers, page.evaluate(tables % "table")))
    for R, t, pose in zip(shown[::2], shown[1::2], ambiguous_pose().alternatives, strict=True):
        np.testing.assert_allclose(R, pose.R, atol=1e-6)
        np.testing.assert_allclose(t[:, 0], pose.t, atol=1e-6)
    # Nothing that is known of one pose alone.
    assert page.evaluate("document.querySelector('#alternatives').hidden")
    facts = page.text("#numbers")
    assert "probability" not in facts and "K1" not in facts and "angle" not in facts
    assert page.text("#pointed") == "There is no pose, so there are no epipolar lines."
    # The next pose takes the place of both.
    page.evaluate("window.fetch = asked_of_the_server")
    page.click("#estimate")
    page.wait("document.querySelector('#verdict').textContent === 'A pose'")
    assert page.evaluate("document.querySelectorAll('#poses table').length") == 2


def test_the_pointer_brings_epipolar_lines(rendered):
    empty = rendered.drawn("#view")
    rendered.hover("#view", (0.25, 0.5))
    pointed = rendered.redrawn("#view", empty)
    assert rendered.text("#pointed").startswith("image 1 (")
    rendered.hover("#view", (0.75, 0.5))
    rendered.redrawn("#view", pointed)
    rendered.click("#show-epipolar")
    rendered.click("#show-lines")
    without = rendered.drawn("#view")
    rendered.hover("#view", (0.25, 0.5))
    rendered.wait("document.querySelector('#pointed').textContent.startsWith('image 1')")
    pointed = rendered.redrawn("#view", without)  # the point alone
    rendered.click("#show-epipolar")
    rendered.hover("#view", (0.25, 0.5))
    rendered.redrawn("#view", pointed)


def test_photographs_that_are_chosen_are_estimated_at_once(page, tmp_path):
    pair = rendered_pair()
    page.choose("#file1", pair.path1, pair.path2)  # both at once
    page.wait(DONE)
    assert page.text("#caption2").startswith("image2.jpg, 720 x 640")
    assert "--K auto" in page.text("#command")
    facts = page.text("#numbers")
    assert "K1\nf " in facts and "K2\nf " in facts and " ± " in facts
    assert "K was not known" in page.text("#basis")


def test_a_file_of_cameras_is_sent_with_its_name(rendered, tmp_path):
    (tmp_path / "my K.txt").write_text("800 0 390 0 800 310 0 0 1")
    assert "K1\nf 820.0 px, cx 404.3, cy 296.8" in rendered.text("#numbers")
    rendered.click("[value=file]")
    rendered.choose("#kfile", tmp_path / "my K.txt")
    rendered.click("#estimate")
    rendered.wait("document.querySelector('#command').textContent.includes(\"--K 'my K.txt'\")")
    assert "K1, K2\nf 800.0 px, cx 390.0, cy 310.0" in rendered.text("#numbers")


def test_what_is_wrong_is_told(page, tmp_path):
    bad = tmp_path / "bad <b>.png"
    bad.write_bytes(b"not an image")
    page.choose("#file1", bad)
    page.wait("!document.querySelector('#error').hidden")
    page.errors.clear()  # the browser notes the refusal
    words = "bad <b>.png: the file is not an image of a known format"
    assert page.text("#error").startswith(words)
    good, turned = tmp_path / "good.png", tmp_path / "turned.png"
    pixels = cv2.imread(str(rendered_pair().path1))[::4, ::4]
    cv2.imwrite(str(good), pixels)
    cv2.imwrite(str(turned), cv2.rotate(pixels, cv2.ROTATE_180))
    page.choose("#file1", good)
    page.wait("document.querySelector('#error').hidden")
    page.choose("#file2", turned)
    page.wait(DONE)
    assert page.text("#verdict") == "A rotation alone"
    assert page.text("#reason").endswith("(rotation_only).")


def test_an_error_stays_until_its_photograph_is_there(page, tmp_path):
    """Whatever is sent to the other place, or estimated, meanwhile."""
    bad, good = tmp_path / "bad.png", rendered_pair().path1
    bad.write_bytes(b"not an image")
    page.choose("#file1", bad)
    page.wait("document.querySelector('#error').textContent.startsWith('bad.png: ')")
    page.errors.clear()  # the browser notes the refusal
    page.choose("#file2", good)
    page.wait("document.querySelector('#caption2').textContent.startsWith('image1.jpg')")
    assert not page.evaluate("document.querySelector('#error').hidden")
    assert page.text("#error").startswith("bad.png: ")
    page.choose("#file1", rendered_pair().path2)
    page.wait(DONE)
    assert page.evaluate("document.querySelector('#error').hidden")


def test_an_empty_field_of_view_is_asked_for(rendered):
    rendered.click("[value=fov]")
    set_value(rendered, "#fov", "")
    rendered.click("#estimate")
    rendered.wait("document.querySelector('#error').textContent.includes('field of view')")
    rendered.errors.clear()  # the browser notes the refusal
    assert rendered.text("#error") == "give the field of view in degrees"


STALE = "document.querySelector('#result').classList.contains('stale')"


def set_value(page, selector, value):
    page.evaluate(
        f"(() => {{ const e = document.querySelector('{selector}'); e.value = '{value}';"
        "e.dispatchEvent(new Event('input', { bubbles: true })); })()"
    )


def test_a_result_belongs_to_its_inputs(map_page, tmp_path):
    page = map_page
    colour = "getComputedStyle(document.querySelector('#verdict')).color"
    fresh = page.evaluate(colour)
    assert not page.evaluate(STALE)
    set_value(page, "#k1", "310,310,159.5,119.5")
    assert page.evaluate(STALE) and page.evaluate(colour) != fresh
    assert "has changed" in page.text("#stale")
    set_value(page, "#k1", dense_scene.K_TEXT)
    assert not page.evaluate(STALE) and page.evaluate(colour) == fresh
    page.click("[value=auto]")
    assert page.evaluate(STALE)
    page.click("[value=k]")
    assert not page.evaluate(STALE)
    set_value(page, "#k1", "")
    cv2.imwrite(str(tmp_path / "other.png"), dense_scene.pictures(seed=1)[0])
    page.choose("#file2", tmp_path / "other.png")
    page.wait("document.querySelector('#caption2').textContent.startsWith('other.png')")
    page.wait("document.querySelector('#error').textContent.startsWith('give K')")
    assert page.evaluate(STALE)
    set_value(page, "#k1", dense_scene.K_TEXT)
    page.click("#estimate")
    page.wait(f"!{STALE}")


@pytest.mark.parametrize("source", ["files", "example"])
def test_images_that_the_server_has_dropped_are_sent_again(map_page, tmp_path, source):
    page = map_page
    paths = [Path(path) for path in dense_scene.write_pictures(tmp_path)]
    if source == "files":
        page.choose("#file1", *paths)
        page.wait(
            f"{DONE} && document.querySelector('#caption1').textContent.startsWith('one.png')"
        )
    # Another tab sends two images, which are all that this server keeps.
    page.choose("#kfile", paths[0])
    page.evaluate(
        "(async () => { const token = document.querySelector('meta[name=token]').content;"
        "for (const name of ['a', 'b']) await fetch(`/images?name=${name}`, { method: 'POST',"
        " headers: { 'x-dgc-pose-token': token },"
        " body: await document.querySelector('#kfile').files[0].arrayBuffer() }); })()"
    )
    set_value(page, "#k1", "310,310,159.5,119.5")
    page.click("#estimate")
    page.wait(f"!{STALE}")
    assert page.evaluate("document.querySelector('#error').hidden")
    assert page.text("#verdict") == "A pose"
    assert "310.0 px" in page.text("#numbers")
    if source == "files":  # those of the package are kept
        assert len(page.errors) == 1 and "410" in page.errors.pop()  # which the browser notes


def test_without_a_pose_nothing_that_a_pose_alone_has_is_shown(page, tmp_path):
    for name, seed in (("one.png", 1), ("two.png", 2)):
        cv2.imwrite(str(tmp_path / name), dense_scene.pictures(seed)[0])
    page.choose("#file1", tmp_path / "one.png", tmp_path / "two.png")
    page.wait(DONE)
    assert page.text("#verdict") == "No pose"
    assert page.text("#reason").endswith(").")  # why, and the status
    assert page.text("#numbers").endswith("agree with the best essential matrix")
    shown = (
        "[...document.querySelectorAll('#result [data-posed], #result canvas')]"
        ".filter((part) => part.offsetParent).map((part) => part.id)"
    )
    assert page.evaluate(shown) == ["view"]
    estimate_rendered(page)
    assert page.text("#verdict") == "A pose"
    assert {"view", "scene", "histogram"} <= set(page.evaluate(shown))
