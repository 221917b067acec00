"""report.html as a user sees and uses it, in headless Chromium."""

import base64
import json
import re
from itertools import product

import cv2
import dtu_layout
import dtu_report
import numpy as np
import pytest
from PIL import Image

from dgc_pose.benchmarks.dtu.dtu_pairs import PAPER_SIZE
from dgc_pose.benchmarks.dtu.report_page import page_data, pictured_pairs, write_report
from dgc_pose.benchmarks.summary import by_method
from dgc_pose.errors import InputError

PICTURED = 12  # of 15 pairs
FACTS = {"protocol": "native", "data": "<b>R&D</b>"}
TABLE = "method  pairs\nnet        15"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return dtu_report.finished_run(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def written(run):
    return write_report(run.out, run.pairs(), run.rows, facts=FACTS, table=TABLE, pictured=PICTURED)


@pytest.fixture(scope="module")
def chosen(run):
    """A pair with pictures, and its entry."""
    keys = pictured_pairs(by_method(run.rows), PICTURED)
    return next(one for one in run.entries if (one.scene, one.view1, one.view2) in keys)


@pytest.fixture
def page(run, written, browser):
    browser.open_anew((run.out / "report.html").as_uri())
    yield browser
    assert browser.errors == []


def name_of(entry) -> str:
    return f"scan{entry.scene} {entry.view1}-{entry.view2}"


def table(page) -> list[list[str]]:
    """The cells of the table, row after row."""
    return page.evaluate(
        "[...document.querySelectorAll('#pairs tbody tr')]"
        ".map((row) => [...row.cells].map((cell) => cell.textContent))"
    )


def column(page, key: str) -> list[str]:
    keys = page.evaluate("[...document.querySelectorAll('th')].map((one) => one.dataset.key)")
    return [row[keys.index(key)] for row in table(page)]


def text(page, selector: str) -> str:
    return page.evaluate(f"document.querySelector({json.dumps(selector)}).textContent")


def places(page, selector: str, image: int) -> np.ndarray:
    """The corners of lines in pixels of an image, by where they stand on the screen: (N, 2, 2)."""
    ends = page.evaluate(
        f"""(() => {{
        const frame = document.querySelectorAll('#stage image')[{image - 1}]
          .getBoundingClientRect();
        return [...document.querySelectorAll({json.dumps(selector)})].map((line) => {{
          const toScreen = line.getScreenCTM();
          return ['1', '2'].map((end) => {{
            const at = new DOMPoint(line['x' + end].baseVal.value, line['y' + end].baseVal.value)
              .matrixTransform(toScreen);
            return [(at.x - frame.x) / frame.width, (at.y - frame.y) / frame.height];
          }});
        }});
        }})()"""
    )
    return np.reshape(ends, (-1, 2, 2)) * (160, 120) - 0.5


def seen(entry, place, depth_mm: float) -> np.ndarray:
    """Where image 2 sees what lies at this depth behind a place of image 1, pixels."""
    pair = entry.pair
    point = pair.R @ (np.linalg.solve(pair.camera1.K, [*place, 1.0]) * depth_mm) + pair.t
    x, y, z = pair.camera2.K @ point
    return np.array([x / z, y / z])


def choose(page, entry) -> None:
    index = [one.split(" ●")[0] for one in column(page, "pair")].index(name_of(entry))
    page.click(f"#pairs tbody tr:nth-child({index + 1})")


def choose_method(page, method: str) -> None:
    number = dtu_report.METHODS.index(method)
    page.evaluate(
        f"(() => {{ const one = document.getElementById('method'); one.value = {number};"
        "one.dispatchEvent(new Event('change', {bubbles: true})); })()"
    )


def test_all_files_are_there_and_are_pictures(run, written) -> None:
    names = {path.name for path in written}
    histograms = product(("rotation", "translation", "epipolar"), ("png", "svg"))
    assert names == {
        *(f"{name}.{end}" for name, end in histograms),
        "motion.png",
        "report.html",
    }
    assert {path.name for path in run.out.iterdir()} == {*names, "matches"}
    for path in written:
        if path.suffix == ".png":
            with Image.open(path) as picture:
                assert min(picture.size) > 300
        elif path.suffix == ".svg":
            assert "<svg" in path.read_text()


def test_the_page_needs_no_other_file(run, written) -> None:
    html = (run.out / "report.html").read_text()
    sources = re.findall(r'(?:src|href)="?([^"\s>]{0,30})', html)
    assert len(sources) >= 5
    assert all(source.startswith(("data:", "${")) for source in sources), sources
    assert "@import" not in html and "url(" not in html


def test_facts_and_table_are_text(page) -> None:
    assert text(page, ".facts dd:last-child") == FACTS["data"]
    assert text(page, "pre") == TABLE
    loaded = page.evaluate("[...document.images].map((one) => one.naturalWidth)")
    assert len(loaded) == 4 and min(loaded) > 100


def test_the_table_has_the_figures_of_the_chosen_method(run, page) -> None:
    for method in ("net", "points"):
        choose_method(page, method)
        rows = [row for row in run.rows if row.method == method]
        expected = ["–" if not row.success else f"{row.rotation_error_deg:.2f}" for row in rows]
        assert column(page, "R") == expected
        assert column(page, "status") == [row.status for row in rows]
        assert column(page, "matches") == [str(row.num_matches) for row in rows]
    assert set(column(page, "all")) == {"–"}
    marked = [one.endswith("●") for one in column(page, "pair")]
    assert sum(marked) == PICTURED
    assert f"{PICTURED} of {len(run.entries)} pairs have pictures" in text(page, ".controls")


def test_a_click_on_a_heading_sorts_and_another_one_turns_the_order(run, page) -> None:
    rows = [row for row in run.rows if row.method == "net"]
    errors = sorted(row.rotation_error_deg for row in rows)
    shown = ["–" if np.isinf(error) else f"{error:.2f}" for error in errors]
    page.click("th[data-key=R]")
    assert column(page, "R") == shown
    assert page.evaluate("document.querySelector('th[data-key=R]').ariaSort") == "ascending"
    page.click("th[data-key=R]")
    assert column(page, "R") == shown[::-1]
    assert page.evaluate("document.querySelectorAll('th[aria-sort]').length") == 1
    page.click("th[data-key=baseline]")
    baselines = [float(one) for one in column(page, "baseline")]
    assert baselines == sorted(baselines) and len(set(baselines)) > 5
    page.click("th[data-key=status]")
    assert column(page, "status") == sorted(row.status for row in rows)


def test_a_click_on_a_row_shows_the_pairs_matches(run, page, chosen) -> None:
    choose(page, chosen)
    assert name_of(chosen) in text(page, "#pair-name")
    assert page.evaluate("document.querySelectorAll('#stage image').length") == 2
    for method in dtu_report.METHODS:
        choose_method(page, method)
        sample = run.samples[(method, chosen.scene, chosen.view1, chosen.view2)]
        assert method in text(page, "#pair-result")
        for kind, own in (("inlier", sample.inliers), ("outlier", ~sample.inliers)):
            starts = places(page, f".match.{kind} line", 1)[:, 0]
            ends = places(page, f".match.{kind} line", 2)[:, 1]
            assert np.abs(starts - sample.points1[own]).max() < 0.1  # shown to a tenth of a pixel
            assert np.abs(ends - sample.points2[own]).max() < 0.1


def test_outliers_can_be_hidden(page, chosen) -> None:
    choose(page, chosen)
    count = "document.querySelectorAll('.match').length"
    assert page.evaluate(count) == dtu_report.COUNT
    page.click("#show-outliers")
    assert page.evaluate(count) == dtu_report.COUNT - dtu_report.OUTLIERS
    assert page.evaluate("document.querySelectorAll('.match.outlier').length") == 0
    page.click("#show-outliers")


@pytest.mark.parametrize("image", [1, 2])
def test_a_click_in_an_image_draws_its_epipolar_line_in_the_other(page, chosen, image) -> None:
    choose(page, chosen)
    origin, other = np.array([45.0, 95.0]), 3 - image
    place = origin if image == 1 else seen(chosen, origin, 700.0)
    page.click(f"#stage image:nth-of-type({image})", tuple((place + 0.5) / (160, 120)))
    assert f"of image {image}: its true epipolar line in image {other}" in text(page, "#selection")
    (ends,) = places(page, "line.epipolar", other)
    assert ((ends > -0.6) & (ends < np.array([160, 120]) - 0.4)).all()
    # Whatever is behind a place of image 1, image 2 sees it on the line.
    depths = (300.0, 650.0, 900.0)
    for point in [seen(chosen, place, z) for z in depths] if image == 1 else [origin]:
        assert off_line(point, *ends) < 0.6  # a mouse's pixel


def test_a_match_under_the_pointer_shows_its_distance_and_a_click_keeps_it(
    run, page, chosen
) -> None:
    choose(page, chosen)
    sample = run.samples[("net", chosen.scene, chosen.view1, chosen.view2)]
    number = 2
    assert not sample.inliers[number]
    page.hover(f".match[data-index='{number}'] circle")
    assert text(page, "#selection").startswith(f"Match {number}: an outlier")
    page.hover("h1")
    assert text(page, "#selection").startswith("Click a match")
    page.click(f".match[data-index='{number}'] circle")
    page.hover("h1")
    found = re.search(r"outlier, (\d+\.\d\d) px", text(page, "#selection"))
    assert found and float(found[1]) == pytest.approx(distance(chosen, sample, number), abs=0.15)
    assert len(places(page, "line.epipolar", 1)) == 2
    assert page.evaluate("document.querySelectorAll('.match.chosen').length") == 1


def distance(entry, sample, number: int) -> float:
    """D_e by where each image sees two points on the ray of the other's place."""
    point1, point2 = sample.points1[number], sample.points2[number]
    pair = entry.pair
    near, far = seen(entry, point1, 400.0), seen(entry, point1, 900.0)
    rays = np.outer([400.0, 900.0], np.linalg.solve(pair.camera2.K, [*point2, 1.0]))
    back = (rays - pair.t) @ pair.R @ pair.camera1.K.T
    other_near, other_far = back[:, :2] / back[:, 2:]
    return (off_line(point2, near, far) + off_line(point1, other_near, other_far)) / 2


def off_line(point, start, end) -> float:
    (dx, dy), (x, y) = (end - start) / np.linalg.norm(end - start), point - start
    return abs(x * dy - y * dx)


def test_the_address_holds_what_is_shown(run, page, chosen) -> None:
    choose_method(page, "net/all")
    choose(page, chosen)
    page.click("th[data-key=folded]")
    page.click("th[data-key=folded]")
    page.click("#stage image", (0.1, 0.9))
    address, shown, drawn = (
        page.evaluate("location.href"),
        table(page),
        page.evaluate("document.getElementById('stage').innerHTML"),
    )
    page.open("about:blank")
    page.open(address)
    assert table(page) == shown
    assert text(page, "#pairs tr.selected td").startswith(name_of(chosen))
    assert page.evaluate("document.getElementById('method').value") == "1"
    again = page.evaluate("document.getElementById('stage').innerHTML")
    numbers = [np.array(re.findall(r'[xyr12]="([\d.]+)"', one), float) for one in (drawn, again)]
    assert len(numbers[0]) > 50 and np.allclose(*numbers, atol=0.01)


@pytest.mark.parametrize(
    "hash", ["pair=scan9 1-2&method=none&sort=no&order=1", "point=3,x&match=-1", "%", "match=9999"]
)
def test_an_address_that_says_nonsense_shows_the_page(run, page, hash) -> None:
    page.open("about:blank")
    page.open((run.out / "report.html").as_uri() + "#" + hash)
    assert len(table(page)) == len(run.entries)
    assert text(page, "#pair-name") == "No pair chosen"


def test_arrow_keys_go_from_row_to_row(page) -> None:
    page.click("#pairs tbody tr:nth-child(2)")
    page.click("#stage image", (0.1, 0.9))  # clear of all matches
    assert len(places(page, "line.epipolar", 2)) == 1
    page.evaluate("document.querySelector('#pairs tbody tr:nth-child(2)').focus()")
    page.press("ArrowDown")
    assert len(places(page, "line.epipolar", 2)) == 0  # it was another pair's
    assert "scan65 1-4" in text(page, "#pair-name")
    page.press("ArrowUp")
    page.press("ArrowUp")
    page.press("ArrowUp")  # beyond the first
    assert "scan65 1-2" in text(page, "#pair-name")


def test_a_pair_without_pictures_says_so(run, page) -> None:
    keys = pictured_pairs(by_method(run.rows), PICTURED)
    entry = next(one for one in run.entries if (one.scene, one.view1, one.view2) not in keys)
    choose(page, entry)
    assert text(page, "#selection") == "This page has no pictures of this pair."
    assert page.evaluate("document.getElementById('stage').childElementCount") == 0
    page.click("#stage")


def test_the_worst_of_each_method_have_pictures_first(run) -> None:
    methods = by_method(run.rows)
    failed = {row.key[1:] for row in run.rows if not row.success}
    first = {min(r.key for r in rows if not r.success)[1:] for rows in methods.values()}
    assert first == pictured_pairs(methods, len(first)) <= failed
    in_order = [(one.scene, one.view1, one.view2) for one in run.entries]
    assert pictured_pairs(methods, 100) == set(in_order)
    assert len(pictured_pairs(methods, PICTURED)) == PICTURED


def test_nothing_is_written_where_a_sample_is_broken(tmp_path) -> None:
    run = dtu_report.finished_run(tmp_path, methods=("points",), pairs=2)
    sample = next((run.out / "matches").iterdir())
    sample.write_text("{}")
    with pytest.raises(InputError, match=re.escape(str(sample))):
        write_report(run.out, run.pairs(), run.rows, facts={}, table="")
    assert [path.name for path in run.out.iterdir()] == ["matches"]


def data_of(run, protocol="native"):
    keys = {row.key[1:] for row in run.rows}
    return page_data(run.out, run.pairs(protocol), by_method(run.rows), keys)


def test_each_image_is_there_once_and_is_the_right_one(run) -> None:
    data = data_of(run)
    assert len(data["images"]) == len(dtu_report.DEGREES)
    for entry, pair in zip(run.entries, data["pairs"], strict=True):
        for side in (1, 2):
            name, image = getattr(entry.pair, f"name{side}"), data["images"][pair[f"image{side}"]]
            assert (image["width"], image["height"]) == dtu_layout.SIZE
            kind, content = image["source"].split(",")
            assert kind == "data:image/jpeg;base64"
            shown = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), 1)
            stored = cv2.imread(str(entry.pair.root / name))
            assert np.abs(shown.astype(float) - stored).mean() < 12


@pytest.mark.parametrize("protocol, size", [("native", dtu_layout.SIZE), ("paper", PAPER_SIZE)])
def test_true_matches_lie_on_the_lines_in_the_protocols_pixels(run, protocol, size) -> None:
    scale = np.array(size) / dtu_layout.SIZE
    data = data_of(run, protocol)
    for entry, pair in zip(run.entries, data["pairs"], strict=True):
        F = np.array(pair["F"]).reshape(3, 3)
        assert np.linalg.norm(F) == pytest.approx(1, abs=1e-6)
        sample = run.samples[("net", entry.scene, entry.view1, entry.view2)]
        one, two = (
            np.column_stack([(points + 0.5) * scale - 0.5, np.ones(len(points))])
            for points in (sample.points1, sample.points2)
        )
        lines = one @ F.T
        distances = np.abs((two * lines).sum(1)) / np.hypot(lines[:, 0], lines[:, 1])
        assert distances[sample.inliers].max() < 0.05  # places are rounded to a hundredth
        assert distances[~sample.inliers].max() > 5


def test_results_are_the_rows_and_null_stands_for_infinite(run) -> None:
    data = json.loads(json.dumps(data_of(run), allow_nan=False))
    assert data["methods"] == [*dtu_report.METHODS]
    for method, results in zip(data["methods"], data["results"], strict=True):
        own = [row for row in run.rows if row.method == method]
        for row, result in zip(own, results, strict=True):
            assert result["seconds"] == row.estimate_seconds
            assert result["R"] == (row.rotation_error_deg if row.success else None)
            assert result["all"] == (None if method == "points" else row.epipolar_all_px)
            sample = run.samples[row.key]
            flat = np.reshape(result["sample"], (-1, 5))
            assert np.abs(flat[:, :2] / 10 - sample.points1).max() <= 0.0501
            assert np.abs(flat[:, 2:4] / 10 - sample.points2).max() <= 0.0501
            assert flat[:, 4].tolist() == sample.inliers.tolist()
