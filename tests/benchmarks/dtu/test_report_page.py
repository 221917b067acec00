"""report.html and the figures beside it, from a finished run that is made up."""

import base64
import json
import re
from dataclasses import replace
from itertools import product

import cv2
import dtu_report
import numpy as np
import pytest
from PIL import Image

from dgc_pose.benchmarks.dtu.report_page import WORST, draw_pair, write_report
from dgc_pose.errors import InputError

FACTS = {"protocol": "native", "data": "<b>R&D</b>"}
TABLE = "method  pairs\nnet        15"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return dtu_report.finished_run(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def html(run) -> str:
    write_report(run.out, run.pairs(), run.rows, facts=FACTS, table=TABLE)
    return (run.out / "report.html").read_text()


def test_all_files_are_there_and_the_page_needs_none_of_them(run, html) -> None:
    names = {path.name for path in run.out.iterdir()}
    histograms = product(("rotation", "translation", "epipolar"), ("png", "svg"))
    assert names == {*(f"{name}.{end}" for name, end in histograms), "report.html"}
    for path in run.out.glob("*.png"):
        with Image.open(path) as picture:
            assert min(picture.size) > 300
    sources = re.findall(r'(?:src|href)="?([^"\s>]{0,30})', html)
    assert len(sources) == 1 + 3 + WORST * len(dtu_report.METHODS)
    assert all(source.startswith("data:") for source in sources), sources
    assert "@import" not in html and "url(" not in html and "<script" not in html
    assert "<dd>&lt;b&gt;R&amp;D&lt;/b&gt;</dd>" in html and f"<pre>{TABLE}</pre>" in html


def test_the_page_has_the_figures_and_the_worst_pairs_of_each_method(run, html) -> None:
    parts = re.split(r"<h2>(.*)</h2>", html)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    for method in dtu_report.METHODS:
        rows = [row for row in run.rows if row.method == method]
        lines = re.findall(r"<tr( class=\"failed\")?>(<td>.*)</tr>", sections[method])
        assert [bool(failed) for failed, _ in lines] == [not row.success for row in rows]
        for row, (_, line) in zip(rows, lines, strict=True):
            cells = re.findall(r"<td>(.*?)</td>", line)
            assert cells[0] == f"scan{row.scene} {row.view1}-{row.view2}"
            assert cells[4] == f"{row.rotation_error_deg:.2f}"  # "inf" without a pose
            assert cells[-1] == row.status and str(row.num_matches) in cells
        rows.sort(key=lambda row: -max(row.rotation_error_deg, row.translation_folded_deg))
        captions = re.findall(r"<figcaption>(scan.*?),", sections[method])
        assert captions == [f"scan{row.scene} {row.view1}-{row.view2}" for row in rows[:WORST]]
    (picture, *_) = re.findall(r'src="data:image/jpeg;base64,([^"]*)"', html)
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), 1)
    assert pixels.shape == (240, 2 * 320, 3)


@pytest.mark.parametrize("protocol", ["native", "paper"])
def test_matches_are_drawn_where_they_are(run, protocol) -> None:
    """Lines leave most of both images as they are, and end at the points of the matches."""
    pair = run.pairs(protocol).pair(0)
    sample = np.array(json.loads(run.rows[0].sample))
    plain, drawn = (draw_pair(pair, some).astype(int) for some in (sample[:0], sample))
    changed = (plain != drawn).any(axis=2)
    assert 0.01 < changed.mean() < 0.5
    scale = 240 / pair.image1.size[1]
    width = round(scale * pair.image1.size[0])
    for points, left in ((sample[:, :2], 0), (sample[:, 2:4], width)):
        x, y = np.rint((points + 0.5) * scale - 0.5).astype(int).T
        inside = (x >= 0) & (x < width) & (y < 240)
        assert changed[y[inside], x[inside] + left].mean() > 0.95
    greener = drawn[changed][:, 1] > drawn[changed][:, 0]
    assert greener.mean() > 0.5 and not greener.all()


def test_nothing_is_written_where_a_sample_is_broken(run, tmp_path) -> None:
    rows = [run.rows[0], replace(run.rows[3], sample="{}")]
    with pytest.raises(InputError, match=r"matches\.csv is not a table"):
        write_report(tmp_path, run.pairs(), rows, facts={}, table="")
    assert list(tmp_path.iterdir()) == []
