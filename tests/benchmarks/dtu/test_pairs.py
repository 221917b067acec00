"""The pairs of DTU's scans, of views whose poses are known."""

import numpy as np
import pytest
from dtu_scan import FIRST, views_of, write_scan
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.dtu.pairs import dtu_pairs
from dgc_pose.errors import InputError
from dgc_pose.metrics import rotation_error_deg


def test_pairs_are_those_of_the_list_with_the_calibration_and_of_all_scans_evenly(tmp_path):
    write_scan(tmp_path)
    pairs = dtu_pairs(tmp_path, 65, "3", 3)
    assert views_of(pairs) == FIRST
    for pair, degrees in zip(pairs, (1, 1, 5), strict=True):
        assert pair.path1.is_file() and pair.path2.is_file() and pair.root == tmp_path
        assert rotation_error_deg(pair.R, np.eye(3)) == pytest.approx(degrees)
        turn = Rotation.from_euler("y", -degrees, degrees=True).as_matrix()
        np.testing.assert_allclose(pair.R, turn, atol=1e-9)
        # All views look at one point, 650 mm away.
        np.testing.assert_allclose(pair.R @ (0, 0, 650) + pair.t, (0, 0, 650), atol=1e-6)
    assert len(dtu_pairs(tmp_path, None, "3", 10**6)) == 448
    write_scan(tmp_path, 4)
    (tmp_path / "Rectified/scan65/rect_028_3_r5000.png").unlink()
    both = dtu_pairs(tmp_path, None, "3", 5)
    assert [pair.name1.split("/")[1] for pair in both] == 3 * ["scan4"] + 2 * ["scan65"]
    assert views_of(both[3:]) == [FIRST[0], FIRST[2]]
    assert not set(views_of(both[:3])) & set(FIRST)


def test_other_layouts_and_lights(tmp_path):
    """The sample set has everything one folder further down."""
    root = tmp_path / "MVS Data"
    write_scan(root, 1, names="Cleaned/scan{scan}/clean_{view:03d}_max.png")
    write_scan(root, 2, names="Rectified/scan{scan}/rect_{view:03d}_max.jpg")
    names = [pair.name1 for pair in dtu_pairs(tmp_path, None, "max", 2)]
    assert [name.split("_")[0] for name in names] == ["Cleaned/scan1/clean", "Rectified/scan2/rect"]
    for scan, light in ((1, "3"), (9, "max")):
        with pytest.raises(InputError, match=f"scan{scan}, of light {light}.*cal18.*Rectified"):
            dtu_pairs(tmp_path, scan, light, 1)
