"""report.html and the figures beside it, from a finished run that is made up."""

import re
from itertools import product

import dtu_report
import pytest
from PIL import Image

from dgc_pose.benchmarks.dtu.report_page import write_report

FACTS = {"protocol": "native", "data": "<b>R&D</b>"}
TABLE = "method  pairs\nnet        15"
ROWS = dtu_report.finished_rows()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    write_report(folder, ROWS, facts=FACTS, table=TABLE)
    return folder


def test_all_files_are_there_and_the_page_needs_none_of_them(folder) -> None:
    html = (folder / "report.html").read_text()
    names = {path.name for path in folder.iterdir()}
    histograms = product(("rotation", "translation", "epipolar"), ("png", "svg"))
    assert names == {*(f"{name}.{end}" for name, end in histograms), "report.html"}
    for path in folder.glob("*.png"):
        with Image.open(path) as picture:
            assert min(picture.size) > 300
    sources = re.findall(r'(?:src|href)="?([^"\s>]{0,30})', html)
    assert len(sources) == 1 + 3
    assert all(source.startswith("data:") for source in sources), sources
    assert "@import" not in html and "url(" not in html and "<script" not in html
    assert "<dd>&lt;b&gt;R&amp;D&lt;/b&gt;</dd>" in html and f"<pre>{TABLE}</pre>" in html


def test_the_page_has_the_figures_of_each_pair_and_method(folder) -> None:
    parts = re.split(r"<h2>(.*)</h2>", (folder / "report.html").read_text())
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    for method in dtu_report.METHODS:
        rows = [row for row in ROWS if row.method == method]
        lines = re.findall(r"<tr( class=\"failed\")?>(<td>.*)</tr>", sections[method])
        assert [bool(failed) for failed, _ in lines] == [not row.success for row in rows]
        for row, (_, line) in zip(rows, lines, strict=True):
            cells = re.findall(r"<td>(.*?)</td>", line)
            assert cells[0] == f"scan{row.scene} {row.view1}-{row.view2}"
            assert cells[4] == f"{row.rotation_error_deg:.2f}"  # "inf" without a pose
            assert cells[-1] == row.status and str(row.num_matches) in cells
