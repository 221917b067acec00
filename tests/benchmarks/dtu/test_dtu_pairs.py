from __future__ import annotations

import numpy as np
import pytest
from dtu_layout import K, arc, write_raw_layout

from dgc_pose.benchmarks.dtu.pairs import (
    PairOptions,
    draw,
    find_candidates,
    make_pairs,
    open_scan,
)
from dgc_pose.errors import InputError


def test_candidates_lie_within_the_limits():
    views = arc(degrees=[0, 4, 10, 30, 75])
    found = find_candidates(views, PairOptions(min_rotation=5, max_rotation=40, min_overlap=0))
    # Of the differences 4 10 30 75 6 26 71 20 65 45, in order of the view numbers.
    assert [(c.view1, c.view2) for c in found] == [(1, 3), (1, 4), (2, 3), (2, 4), (3, 4)]
    assert [c.rotation_deg for c in found] == pytest.approx([10, 30, 6, 26, 20])


def test_the_least_overlap_is_asked_for():
    views = arc(degrees=[0, 10, 20, 30])
    wide = find_candidates(views, PairOptions(min_overlap=0.0))
    narrow = find_candidates(views, PairOptions(min_overlap=0.88))
    assert 0 < len(narrow) < len(wide)
    # Around an arc the overlap falls with the rotation.
    assert max(c.rotation_deg for c in narrow) < max(c.rotation_deg for c in wide)


def test_the_draw_is_seeded_and_spread_over_the_rotations():
    options = PairOptions(pairs=14, min_overlap=0, seed=5)
    candidates = find_candidates(arc(degrees=np.arange(0, 60, 2.3)), options)
    drawn = draw(candidates, options)
    assert drawn == draw(candidates, options)
    assert len(set(drawn)) == 14
    assert drawn != draw(candidates, PairOptions(pairs=14, min_overlap=0, seed=6))
    # Seven bins of five degrees: every seven drawn hold one of each.
    for part in (drawn[:7], drawn[7:]):
        bins = [min(int((c.rotation_deg - 5) // 5), 6) for c in part]
        assert sorted(bins) == list(range(7))


def test_no_more_pairs_are_drawn_than_there_are():
    options = PairOptions(pairs=50, min_overlap=0)
    candidates = find_candidates(arc(degrees=[0, 6, 12]), options)
    assert len(candidates) == 3
    assert set(draw(candidates, options)) == set(candidates)


def test_pairs_carry_the_calibration(tmp_path):
    views = write_raw_layout(tmp_path, degrees=[0, 12], extension="jpg")
    scan = open_scan(tmp_path, scan=65, light=3)
    options = PairOptions(min_overlap=0)
    (pair,) = make_pairs(scan, find_candidates(scan.views, options))
    assert pair.path1 == tmp_path / "Rectified/scan65/rect_001_3_r5000.jpg"
    assert pair.name2 == "Rectified/scan65/rect_002_3_r5000.jpg"
    assert np.allclose(pair.camera1.K, K, atol=1e-5)
    assert pair.camera1.size == (1600, 1200)
    expected = views[2].R @ views[1].R.T
    assert np.allclose(pair.R, expected, atol=1e-8)
    assert np.allclose(pair.t, views[2].t - expected @ views[1].t, atol=1e-3)


def test_views_without_an_image_or_a_calibration_are_left_out_and_counted(tmp_path):
    write_raw_layout(tmp_path, degrees=[0, 10, 20, 30, 40], extension="png")
    (tmp_path / "Rectified/scan65/rect_002_3_r5000.png").unlink()
    (tmp_path / "Calibration/cal18/pos_004.txt").unlink()
    scan = open_scan(tmp_path, scan=65, light=3)
    assert sorted(scan.views) == sorted(scan.images) == [1, 3, 5]
    assert scan.absent == 2


def test_of_two_files_of_a_view_the_png_is_taken(tmp_path):
    write_raw_layout(tmp_path, degrees=[0, 10], extension="png")
    (tmp_path / "Rectified/scan65/rect_001_3_r5000.jpg").write_bytes(b"")
    assert open_scan(tmp_path, scan=65, light=3).images[1].endswith(".png")


def test_another_light_is_another_image(tmp_path):
    write_raw_layout(tmp_path, degrees=[0, 10], extension="png", light=5)
    assert len(open_scan(tmp_path, scan=65, light=5).views) == 2
    with pytest.raises(InputError, match="fewer than two views of scan 65 under light 3"):
        open_scan(tmp_path, scan=65, light=3)


@pytest.mark.parametrize("folder", ["Calibration/cal18", "Rectified/scan65"])
def test_a_missing_folder_is_an_error_with_its_path(tmp_path, folder):
    write_raw_layout(tmp_path, degrees=[0, 10], extension="png")
    (tmp_path / folder).rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=folder):
        open_scan(tmp_path, scan=65, light=3)


def test_a_short_calibration_file_is_an_error_with_its_path(tmp_path):
    write_raw_layout(tmp_path, degrees=[0, 10], extension="png")
    (tmp_path / "Calibration/cal18/pos_002.txt").write_text("1 2 3 4\n")
    with pytest.raises(InputError, match=r"pos_002\.txt: expected 3 rows of 4 numbers"):
        open_scan(tmp_path, scan=65, light=3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"pairs": 0},
        {"min_rotation": 40.0, "max_rotation": 40.0},
        {"min_rotation": -1.0},
        {"max_rotation": 181.0},
        {"min_overlap": 1.5},
        {"min_overlap": float("nan")},
    ],
)
def test_options_out_of_range_are_refused(wrong):
    with pytest.raises(InputError):
        PairOptions(**wrong)
