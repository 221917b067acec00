from collections import Counter

import numpy as np
import pytest
from dtu_layout import SIZE, arc, write_scan
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.dtu.dataset import DtuScene, DtuView, open_dataset
from dgc_pose.benchmarks.dtu.view_pairs import (
    ViewPairOptions,
    draw,
    find_view_pairs,
    listed_pair,
    overlap,
)


def scenes(*degrees):
    """A scene for each list of angles, numbered from 1, with no files behind it."""
    views = map(arc, degrees)
    return [DtuScene(number, on_arc, {}, SIZE) for number, on_arc in enumerate(views, start=1)]


def test_candidates_lie_within_the_limits():
    options = ViewPairOptions(min_rotation=5, max_rotation=40, min_overlap=0)
    found = find_view_pairs(scenes([0, 4, 10, 30, 75]), options)
    # Of the differences 4 10 30 75 6 26 71 20 65 45, in order of the view numbers.
    assert [(p.view1, p.view2) for p in found] == [(1, 3), (1, 4), (2, 3), (2, 4), (3, 4)]
    assert [p.rotation_deg for p in found] == pytest.approx([10, 30, 6, 26, 20])
    views = found[0].scene.views
    least = overlap(views[1], views[3], SIZE)
    assert least < overlap(views[2], views[3], SIZE)
    nearer = find_view_pairs(scenes([0, 4, 10]), ViewPairOptions(min_overlap=least + 1e-9))
    assert [(p.view1, p.view2) for p in nearer] == [(2, 3)]


def shared(degrees=0.0, shift=0.0):
    """The overlap of a view of 1600 x 1200 pixels with the same turned and moved sideways, mm."""
    K = np.array([[2890.0, 0, 799.5], [0, 2890, 599.5], [0, 0, 1]])
    R = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    first, second = DtuView(K, np.eye(3), np.zeros(3)), DtuView(K, R, np.array([shift, 0, 0]))
    return overlap(first, second, (1600, 1200))


def test_overlap_is_the_share_that_both_views_see():
    # The image ends 800 px from its middle: this turn takes the middle to the edge.
    half = np.degrees(np.arctan(800 / 2890))
    assert [shared(), shared(180)] == [1, 0]
    assert shared(half) == pytest.approx(0.5, abs=0.05)
    # Beyond the width of the view at the greatest depth, 935 mm * 1600 / 2890, nothing is shared.
    shares = [shared(shift=shift) for shift in (50, 100, 200, 520)]
    assert shares == sorted(shares, reverse=True) and shares[2] > shares[3] == 0


def test_the_draw_is_seeded_balanced_over_scenes_and_spread_over_the_rotations_of_each():
    angles = np.arange(0, 60, 2.3)
    data = scenes(angles, angles, [0, 6, 12], angles)
    options = ViewPairOptions(pairs=45, min_overlap=0)
    candidates = find_view_pairs(data, options)
    drawn = draw(candidates, options)
    assert drawn == draw(candidates, options)
    assert drawn != draw(candidates, ViewPairOptions(pairs=45, min_overlap=0, seed=6))
    # The third scene has three pairs in all; the others share the rest.
    assert Counter(p.scene.number for p in drawn) == {1: 14, 2: 14, 3: 3, 4: 14}
    assert [p.scene.number for p in drawn] == sorted(p.scene.number for p in drawn)
    assert len({(p.scene.number, p.view1, p.view2) for p in drawn}) == 45
    chosen = {}
    for scene in (1, 2, 4):
        pairs = [p for p in drawn if p.scene.number == scene]
        bins = Counter(min(int((p.rotation_deg - 5) // 5), 6) for p in pairs)
        assert bins == dict.fromkeys(range(7), 2)
        chosen[scene] = {(p.view1, p.view2) for p in pairs}
    # Scenes of the same cameras do not draw the same views.
    assert chosen[1] != chosen[2] != chosen[4] != chosen[1]


def test_pairs_carry_the_calibration(tmp_path):
    views = arc([0, 12])
    write_scan(tmp_path, [0, 12])
    root, found = open_dataset(tmp_path)
    (only,) = find_view_pairs(found, ViewPairOptions(min_overlap=0))
    pair = listed_pair(root, only)
    assert pair.path1 == tmp_path / "Rectified/scan65/rect_001_3_r5000.png"
    assert pair.name2 == "Rectified/scan65/rect_002_3_r5000.png"
    assert np.allclose(pair.camera1.K, views[1].K, atol=1e-9)
    assert pair.camera1.size == pair.camera2.size == SIZE
    expected = views[2].R @ views[1].R.T
    assert np.allclose(pair.R, expected, atol=1e-12)
    assert np.allclose(pair.t, views[2].t - expected @ views[1].t, atol=1e-9)


def test_views_of_one_centre_make_no_pair():
    views = dict(arc([0, 10, 10]))
    views[4] = DtuView(views[1].K, views[2].R, views[2].R @ views[1].R.T @ views[1].t)  # 1, turned
    options = ViewPairOptions(min_rotation=0, min_overlap=0)
    found = find_view_pairs([DtuScene(1, views, {}, SIZE)], options)
    assert [(p.view1, p.view2) for p in found] == [(1, 2), (1, 3), (2, 4), (3, 4)]
