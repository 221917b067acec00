"""The table of pairs that a folder gives, in a browser."""

import re

import cv2
import dense_scene
import numpy as np
import pytest
from serve_parts import DONE, estimate_rendered

from dgc_pose.geometry.rotation import rotation_angle_deg

pytestmark = pytest.mark.slow

ROWS = "[...document.querySelectorAll('#pairs tbody tr')]"
TEXTS = f"{ROWS}.map((row) => [...row.cells].map((cell) => cell.innerText.trim()))"
FINISHED = "document.querySelector('#pairs-progress').textContent.endsWith('with a pose')"
HIDDEN = "document.querySelector('#pairs').hidden"
# How many poses are asked for; the one of this number fails.
COUNTED = """(() => {
  const ask = window.fetch;
  window.asked = 0;
  window.fetch = async (path, ...rest) => {
    if (path !== '/poses' || ++asked !== %d) return ask(path, ...rest);
    return new Response('{"error": "out of luck"}\\n');
  };
})()"""


@pytest.fixture
def folder(tmp_path):
    """Two photographs of a scene and one of another, among other files."""
    root = tmp_path / "folder"
    (root / "more").mkdir(parents=True)
    one, two = dense_scene.pictures()
    names = ("a1.png", "a2.png", "more/a10.png")
    for name, picture in zip(names, (one, two, dense_scene.pictures(seed=1)[0]), strict=True):
        cv2.imwrite(str(root / name), picture[..., ::-1])
    (root / ".hidden.png").write_bytes(b"")
    (root / "notes.txt").write_text("of another kind")
    return root


@pytest.fixture
def table(page, folder):
    """The page with the poses of the folder's pairs."""
    page.click("[value=k]")
    page.evaluate(f"document.querySelector('#k1').value = '{dense_scene.K_TEXT}'")
    page.drop("#drop2", folder)
    page.wait(FINISHED)
    return page


def test_a_folder_gives_a_table_of_its_pairs(table):
    assert table.text("#taken") == "3 of 4 files are photographs by type or name; 3 are taken."
    assert table.text("#pairs-progress") == "3 pairs, 1 with a pose"
    first, second, third = table.evaluate(TEXTS)
    assert [row[0] for row in (first, second, third)] == [
        "a1.png, a2.png",
        "a1.png, a10.png",
        "a2.png, a10.png",
    ]
    assert first[1] == "A pose"
    angle = float(first[3].removesuffix("°"))
    assert angle == pytest.approx(rotation_angle_deg(dense_scene.R), abs=0.5)
    assert re.fullmatch(r"R within [\d.]+°, t within [\d.]+°", first[4])
    for row in (second, third):
        assert row[1].startswith("No pose\n") and row[1].endswith(").")  # with the reason
        assert row[2:5] == ["", "", ""] and " matches" in row[5]
    # Only the photographs stand above, and no result is of them yet.
    assert table.text("#caption2").startswith("a2.png") and not table.text("#verdict")


@pytest.mark.parametrize("way", ["mouse", "keys"])
def test_a_pair_that_is_chosen_is_shown_below(table, way):
    if way == "mouse":
        table.click("#pairs tbody tr:nth-child(1) td:nth-child(4)")
    else:
        table.evaluate(f"{ROWS}[0].querySelector('button').focus()")
        table.press("Enter")
    table.wait(DONE)
    row = table.evaluate(TEXTS)[0]
    numbers = table.text("#numbers")
    assert table.text("#verdict") == row[1]
    assert f"rotation angle\n{row[3]}\n" in numbers and f"inliers\n{row[5]}\n" in numbers
    assert f"{row[4]}, nine times in ten if the pose is right" in numbers
    assert table.evaluate(f"{ROWS}.map((row) => row.ariaCurrent)") == ["true", "false", "false"]
    table.click("#pairs tbody tr:nth-child(2) button")
    table.wait("document.querySelector('#verdict').textContent === 'No pose'")
    assert table.text("#caption2").startswith("a10.png")
    assert table.text("#numbers").endswith("agree with the best essential matrix")
    assert not table.evaluate(HIDDEN)


def test_a_pair_that_fails_is_a_line_and_the_others_follow(page, folder):
    page.evaluate(COUNTED % 2)
    (folder / "b.png").write_bytes(b"not an image")
    page.choose("#file1", *folder.glob("*.png"), folder / "more" / "a10.png")
    page.wait(FINISHED)
    page.errors.clear()  # the browser notes the refusal
    assert "b.png: the file is not an image of a known format" in page.text("#error")
    rows = page.evaluate(TEXTS)
    assert len(rows) == 3 and rows[1][1:] == ["out of luck"]
    assert rows[2][1].startswith("No pose")


def test_other_photographs_end_the_table(page, tmp_path):
    small = dense_scene.pictures()[0][::4, ::4]
    paths = [tmp_path / f"{n}.png" for n in range(14)]
    for n, path in enumerate(paths):
        cv2.imwrite(str(path), np.roll(small, n, axis=1))
    page.evaluate(COUNTED % 0)
    page.choose("#file1", *paths)
    page.wait("asked > 2")
    expected = "14 of 14 files are photographs by type or name; 12 are taken."
    assert page.text("#taken") == expected
    names = [row[0] for row in page.evaluate(TEXTS)]
    assert len(names) == 66 and names[0] == "0.png, 1.png" and names[-1] == "10.png, 11.png"
    estimate_rendered(page)
    assert page.evaluate(HIDDEN) and page.text("#taken") == ""
    before = page.evaluate("asked")
    page.click("#estimate")
    page.wait(f"asked > {before} && {DONE}")
    assert page.evaluate("asked") == before + 1


def test_a_table_belongs_to_its_camera(table):
    stale = "document.querySelector('#pairs').classList.contains('stale')"
    assert not table.evaluate(stale) and "has changed" not in table.text("#pairs")
    before = table.evaluate(TEXTS)[0]
    table.click("[value=fov]")
    assert table.evaluate(stale) and "has changed" in table.text("#pairs")
    table.evaluate("document.querySelector('#fov').value = 40")
    table.click("#estimate-pairs")
    table.wait(f"!{stale} && {FINISHED}")
    assert table.evaluate(TEXTS)[0] != before


@pytest.mark.parametrize("width", [390, 768, 1280])
def test_the_table_fits_into_the_window(table, width):
    try:
        table.resize(width, 800)
        cells = table.evaluate(
            "[...document.querySelectorAll('#pairs, #pairs td')].map((part) => {"
            " const { left, right } = part.getBoundingClientRect(); return [left, right]; })"
        )
        assert np.min(cells) >= 0 and np.max(cells) <= width
        assert table.evaluate("document.scrollingElement.scrollWidth") <= width
    finally:
        table.resize(1400, 1600)
