from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from dtu_layout import SIZE, arc, grey_scan, write_raw
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.dtu.calibration import DtuView
from dgc_pose.benchmarks.dtu.dataset import Dataset, DtuScene, open_dataset
from dgc_pose.benchmarks.dtu.view_pairs import (
    ViewPairOptions,
    draw,
    find_view_pairs,
    listed_pair,
    overlap,
    view_pair,
)
from dgc_pose.errors import InputError


def dataset(*degrees):
    """A scene for each list of angles, numbered from 1, with no files behind it."""
    scenes = []
    for number, angles in enumerate(degrees, start=1):
        views = arc(angles)
        images = {n: Path(f"/dtu/scan{number}/{n}.png") for n in views}
        scenes.append(DtuScene(number, views, images, SIZE))
    return Dataset(Path("/dtu"), tuple(scenes), ())


def test_candidates_lie_within_the_limits():
    views = dataset([0, 4, 10, 30, 75])
    found = find_view_pairs(views, ViewPairOptions(min_rotation=5, max_rotation=40, min_overlap=0))
    # Of the differences 4 10 30 75 6 26 71 20 65 45, in order of the view numbers.
    assert [(p.view1, p.view2) for p in found] == [(1, 3), (1, 4), (2, 3), (2, 4), (3, 4)]
    assert [p.rotation_deg for p in found] == pytest.approx([10, 30, 6, 26, 20])


def test_candidates_say_what_the_calibration_says():
    data = dataset([0, 10], [0, 25, 31])
    for pair in find_view_pairs(data, ViewPairOptions(min_overlap=0)):
        views = data.scene(pair.scene).views
        one, two = views[pair.view1], views[pair.view2]
        angle = np.radians(pair.rotation_deg)
        assert pair.baseline_mm == pytest.approx(2 * 650 * np.sin(angle / 2))  # a chord of the arc
        assert pair.overlap == overlap(one, two, SIZE)
        assert pair == view_pair(data.scene(pair.scene), pair.view1, pair.view2)


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
    data = dataset(angles, angles, [0, 6, 12], angles)
    options = ViewPairOptions(pairs=45, min_overlap=0)
    candidates = find_view_pairs(data, options)
    drawn = draw(candidates, options)
    assert drawn == draw(candidates, options)
    assert drawn != draw(candidates, ViewPairOptions(pairs=45, min_overlap=0, seed=6))
    # The third scene has three pairs in all; the others share the rest.
    assert Counter(p.scene for p in drawn) == {1: 14, 2: 14, 3: 3, 4: 14}
    assert [p.scene for p in drawn] == sorted(p.scene for p in drawn)
    assert len(set(drawn)) == 45
    chosen = {}
    for scene in (1, 2, 4):
        pairs = [p for p in drawn if p.scene == scene]
        bins = Counter(min(int((p.rotation_deg - 5) // 5), 6) for p in pairs)
        assert bins == dict.fromkeys(range(7), 2)
        chosen[scene] = {(p.view1, p.view2) for p in pairs}
    # Scenes of the same cameras do not draw the same views.
    assert chosen[1] != chosen[2] != chosen[4] != chosen[1]


def test_pairs_carry_the_calibration(tmp_path):
    scan = grey_scan([0, 12])
    write_raw(tmp_path, scan, extension="jpg")
    data = open_dataset(tmp_path)
    (found,) = find_view_pairs(data, ViewPairOptions(min_overlap=0))
    pair = listed_pair(data, found)
    assert pair.path1 == tmp_path / "Rectified/scan65/rect_001_3_r5000.jpg"
    assert pair.name2 == "Rectified/scan65/rect_002_3_r5000.jpg"
    assert np.allclose(pair.camera1.K, scan.views[1].K, atol=1e-9)
    assert pair.camera1.size == pair.camera2.size == SIZE
    expected = scan.views[2].R @ scan.views[1].R.T
    assert np.allclose(pair.R, expected, atol=1e-12)
    assert np.allclose(pair.t, scan.views[2].t - expected @ scan.views[1].t, atol=1e-9)


def test_views_of_one_centre_make_no_pair():
    data = dataset([0, 10, 10])
    views = dict(data.scenes[0].views)
    views[4] = DtuView(views[1].K, views[2].R, views[2].R @ views[1].R.T @ views[1].t)  # 1, turned
    scene = DtuScene(1, views, {n: Path(f"/dtu/{n}.png") for n in views}, SIZE)
    data = Dataset(Path("/dtu"), (scene,), ())
    found = find_view_pairs(data, ViewPairOptions(min_rotation=0, min_overlap=0))
    assert [(p.view1, p.view2) for p in found] == [(1, 2), (1, 3), (2, 4), (3, 4)]
    for one, two in ((1, 4), (2, 3), (1, 1)):
        with pytest.raises(InputError, match=f"views {one} and {two} of scan1 have one and the"):
            view_pair(scene, one, two)
    with pytest.raises(InputError, match="scan1 has no view 77"):
        view_pair(scene, 1, 77)
