"""The page in a browser, as a user would use it."""

import json
import subprocess
import sys

import cv2
import numpy as np
import pytest
from ambiguous_pose import ambiguous_pose
from chromium import chromium_page, find_chromium

from dgc_pose.cameras.pair_list import bundled_pair
from dgc_pose.cli.output import pose_data

DONE = "document.querySelector('#progress').textContent.startsWith('done')"
PIXELS = """(() => {
  const canvas = document.querySelector('%s');
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  return data.reduce((sum, value, n) => (sum + value * (n %% 251)) %% 1000003, 0);
})()"""


@pytest.fixture(scope="module")
def url():
    """A server's address. SIFT, whose pose of the bundled pair takes a second."""
    command = [sys.executable, "-m", "dgc_pose", "serve", "--no-browser", "--weights", "sift"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.communicate(timeout=60)


@pytest.fixture(scope="module")
def browser(url):
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium on this machine: install it, or name one in $CHROMIUM")
    with chromium_page(executable) as page:
        page.own += (url.split("?")[0], "blob:")
        yield page


@pytest.fixture
def page(url, browser):
    browser.errors.clear()
    browser.open("about:blank")
    browser.open(url)
    yield browser
    assert browser.errors == []


@pytest.fixture
def example(page):
    """The page with the bundled pair's pose."""
    page.click("#example")
    page.wait(DONE)
    return page


def text(page, selector):
    return page.evaluate(f"document.querySelector({selector!r}).innerText")


def drawn(page, selector):
    """A number that changes with what a canvas shows."""
    return page.evaluate(PIXELS % selector)


def redrawn(page, selector, before):
    """The same, when it is another than before."""
    page.wait(f"{PIXELS % selector} !== {before}")
    return drawn(page, selector)


def test_the_bundled_pair_gets_its_pose(example):
    assert text(example, "#verdict") == "A pose (ok)"
    assert "inliers" in text(example, "#numbers") and "expected error" in text(example, "#numbers")
    pair = bundled_pair()
    first = [float(v) for v in text(example, "#poses table").split("\n")[-3].split()[1:4]]
    assert first == pytest.approx(pair.R[0], abs=0.01)
    assert str(pair.path1) in text(example, "#command")
    assert "--weights sift" in text(example, "#command")
    # A matcher of key points has no map.
    assert example.evaluate("document.querySelector('#map-part').hidden")


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


def test_alternatives_and_the_probability_are_shown_if_there_are_any(example):
    page = example
    assert "probability" not in text(page, "#numbers")  # none is fitted for this matcher
    assert page.evaluate("document.querySelector('#alternatives').hidden")
    turned = {"R": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "t": [0.6, 0, 0.8], "num_inliers": 77}
    others = [turned | {"probability": None}, turned | {"probability": 0.125}]
    changes = {"pose": {"probability": 0.8, "alternatives": others}}
    page.evaluate(CHANGED % json.dumps(changes))
    page.click("#example")
    page.wait("!document.querySelector('#alternatives').hidden")
    assert "80 %, that R and t are within 10°" in text(page, "#numbers")
    assert text(page, "#alternatives summary").startswith("2 other poses explain the matches")
    page.click("#alternatives summary")
    first, second = text(page, "#alternatives ol").splitlines()
    assert first == "rotation angle 90.00°, t (0.6000, 0.0000, 0.8000), 77 inliers"
    assert second == first + ", probability 13 %"


@pytest.fixture
def ambiguous(page):
    """The page with an answer of two poses."""
    pose = pose_data(ambiguous_pose())
    changes = {"pose": pose, "reason": pose["warnings"][0], "F": None}
    page.evaluate(CHANGED % json.dumps(changes))
    page.click("#example")
    page.wait(DONE)
    return page


def test_both_poses_of_an_ambiguous_pair_are_shown(ambiguous):
    page = ambiguous
    assert not page.evaluate("document.querySelector('#undecided').hidden")
    assert text(page, "#verdict") == "Two poses explain these photographs"
    assert "do not show which of them is right" in text(page, "#undecided")
    tables = "[...document.querySelectorAll('#poses table')].map((table) => table.innerText)"
    shown = page.evaluate(tables)
    captions = [table.split("\n")[0] for table in shown]
    assert captions == [
        "Pose 1: probability 52 %, 271 inliers, rotation 28.65°",
        "Pose 2: probability 45 %, 270 inliers, rotation 18.12°",
    ]
    for table, pose in zip(shown, ambiguous_pose().alternatives, strict=True):
        cells = [line.split() for line in table.split("\n")[-3:]]
        R = [[float(cell) for cell in row[1:4]] for row in cells]
        np.testing.assert_allclose(R, pose.R, atol=1e-6)
        np.testing.assert_allclose([float(row[5]) for row in cells], pose.t, atol=1e-6)
    # Nothing that is known of one pose alone.
    assert page.evaluate("document.querySelector('#alternatives').hidden")
    numbers = text(page, "#numbers")
    assert "probability" not in numbers and "K1" not in numbers and "angle" not in numbers
    assert text(page, "#pointed") == "There is no pose, so there are no epipolar lines."


def test_the_next_pose_takes_the_place_of_two(ambiguous):
    ambiguous.evaluate("window.fetch = asked_of_the_server")
    ambiguous.click("#estimate")
    ambiguous.wait("document.querySelector('#undecided').hidden")
    assert text(ambiguous, "#verdict") == "A pose (ok)"
    assert ambiguous.evaluate("document.querySelectorAll('#poses table').length") == 1


def test_both_poses_fit_into_the_window(ambiguous):
    right = "e.getBoundingClientRect().right"
    try:
        for width in (360, 800, 1400):
            ambiguous.resize(width, 1600)
            ends = ambiguous.evaluate(
                f"[...document.querySelectorAll('#poses td, #poses caption')].map((e) => {right})"
            )
            edge = ambiguous.evaluate(f"((e) => {right})(document.querySelector('#result'))")
            assert max(ends) < edge <= width
    finally:
        ambiguous.resize(1400, 1600)


def test_the_pointer_brings_epipolar_lines(example):
    empty = drawn(example, "#view")
    example.hover("#view", (0.25, 0.5))
    pointed = redrawn(example, "#view", empty)
    assert "image 1, pixel" in text(example, "#pointed") or "match" in text(example, "#pointed")
    example.hover("#view", (0.75, 0.5))
    redrawn(example, "#view", pointed)
    example.click("#show-epipolar")
    example.click("#show-lines")
    without = drawn(example, "#view")
    example.hover("#view", (0.25, 0.5))
    example.wait("document.querySelector('#pointed').textContent.startsWith('image 1')")
    assert drawn(example, "#view") == without  # neither lines nor matches were asked for


def test_the_tools_change_what_is_drawn(example):
    before = drawn(example, "#view")
    for selector, value in (("#count", "20"), ("#limit", "5")):
        example.evaluate(
            f"(() => {{ const e = document.querySelector('{selector}'); e.value = {value};"
            "e.dispatchEvent(new Event('input')); })()"
        )
        before = redrawn(example, "#view", before)
    assert "px" in text(example, "#limit-text") and text(example, "#count-text") == "20"
    example.click("#show-outliers")
    redrawn(example, "#view", before)


def test_photographs_that_are_chosen_are_estimated_at_once(page, tmp_path):
    pair = bundled_pair()
    page.choose("#file1", pair.path1, pair.path2)  # both at once
    page.wait(DONE)
    assert text(page, "#caption2").startswith("image2.jpg, 720 x 640")
    assert "--K auto" in text(page, "#command")
    numbers = text(page, "#numbers")
    assert "K1\nf " in numbers and "K2\nf " in numbers and " ± " in numbers


def test_a_file_of_cameras_is_sent_with_its_name(example, tmp_path):
    (tmp_path / "my K.txt").write_text("800 0 390 0 800 310 0 0 1")
    assert "K1\nf 820.0 px, cx 404.3, cy 296.8" in text(example, "#numbers")
    example.choose("#kfile", tmp_path / "my K.txt")
    assert example.evaluate("document.querySelector('input[name=kind]:checked').value") == "file"
    example.click("#estimate")
    example.wait("document.querySelector('#command').textContent.includes(\"--K 'my K.txt'\")")
    assert "K1, K2\nf 800.0 px, cx 390.0, cy 310.0" in text(example, "#numbers")


def test_what_is_wrong_is_told(page, tmp_path):
    bad = tmp_path / "bad <b>.png"
    bad.write_bytes(b"not an image")
    page.choose("#file1", bad)
    page.wait("!document.querySelector('#error').hidden")
    page.errors.clear()  # the browser notes the refusal
    words = "bad <b>.png: the file is not an image of a known format"
    assert text(page, "#error").startswith(words)
    good = tmp_path / "good.png"
    cv2.imwrite(str(good), cv2.imread(str(bundled_pair().path1))[::4, ::4])
    page.choose("#file1", good)
    page.wait("document.querySelector('#error').hidden")
    page.choose("#file2", good)
    page.wait(DONE)  # the same image twice: no pose, and the reason
    assert text(page, "#verdict").startswith("No pose (")


def test_a_result_is_saved_as_json_and_png(example):
    example.evaluate(
        "(() => { window.saved = []; URL.createObjectURL = (blob) => { saved.push(blob);"
        " return 'data:,'; }; HTMLAnchorElement.prototype.click = function () {"
        " this.download && saved.push(this.download); }; })()"
    )
    example.click("#save-json")
    example.click("#save-png")
    example.wait("saved.length === 4")
    names = "saved.filter((part) => typeof part === 'string')"
    assert example.evaluate(names) == ["pose.json", "pose.png"]
    data = json.loads(example.evaluate("saved[0].text()"))
    assert data["status"] == "ok" and len(data["matches"]["points"]) > 100
    kind, size = example.evaluate(
        "createImageBitmap(saved[2]).then((b) => [saved[2].type, b.width])"
    )
    assert kind == "image/png" and size > 800
