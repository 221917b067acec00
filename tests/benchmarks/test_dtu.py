import csv

import cv2
import numpy as np
import pytest
from command_line import assert_refused, run
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.posed_pairs import dtu_pairs, read_projection
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.errors import InputError
from dgc_pose.metrics import rotation_error_deg

# The first position of DTU's calibration, as published.
POS_001 = """2607.429996 -3.844898 1498.178098 -533936.661373
-192.076910 2862.552532 681.798177 23434.686572
-0.241605 -0.030951 0.969881 22.540121
"""
DEGREES = np.arange(49.0)  # of DTU's positions on an arc: views 1 and 2 differ by one degree
FIRST = [(24, 25), (28, 29), (3, 8)]  # pairs of scan65
SIZE = (160, 120)
# DTU's camera at a tenth of its size.
K = Camera(np.array([[2892.0, 0, 823], [0, 2883, 619], [0, 0, 1]]), (1600, 1200)).resized(SIZE).K


def write_scan(root, number=65, *, names="Rectified/scan{scan}/rect_{view:03d}_3_r5000.png"):
    """The calibration and the grey images of a scan, as DTU has them, of views that look at one
    point 650 mm away from `DEGREES` around it."""
    for view, angle in enumerate(np.radians(DEGREES), start=1):
        c, s = np.cos(angle), np.sin(angle)
        calibration = root / f"Calibration/cal18/pos_{view:03d}.txt"
        calibration.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(calibration, K @ [[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 650]], fmt="%.17g")
        path = root / names.format(scan=number, view=view)
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((*SIZE[::-1], 3), 128, np.uint8))


def views_of(pairs):
    return [tuple(int(n.split("_")[1]) for n in (p.name1, p.name2)) for p in pairs]


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


def test_the_command_scores_the_list_by_the_protocol_of_the_paper(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(run("bench-dtu", "dtu", "--out", "run"), "a scan")
    write_scan(tmp_path / "dtu")
    fast = ("--methods", "sift", "--runs", "1", "--iterations", "50", "--out")
    assert run("bench-dtu", "dtu", "--scan", "65", "--pairs", "3", *fast, "run").exit_code == 0
    other = ("--scan", "65", "--pairs", "2", "--resume")
    assert run("bench-dtu", "dtu", *other, *fast, "run").exit_code == 2  # pairs.txt stays
    assert views_of(read_pairs("run/pairs.txt", "dtu")) == FIRST
    words = ("run/pairs.txt", "--root", "dtu", "--protocol", "paper", *fast, "again")
    assert run("bench-pairs", *words).exit_code == 0
    first, again = (list(csv.DictReader(open(f"{name}/results.csv"))) for name in ("run", "again"))
    for name in ("image1", "image2", "status", "num_inliers", "rotation_error_deg"):
        assert [row[name] for row in first] == [row[name] for row in again]


@pytest.mark.parametrize("scale", [1.0, -250.0])
def test_a_projection_matrix_of_any_scale_gives_its_camera(tmp_path, scale):
    """The first position, as published."""
    path = tmp_path / "pos_001.txt"
    np.savetxt(path, scale * np.fromstring(POS_001, sep=" ").reshape(3, 4), fmt="%.9g")
    K, R, t = read_projection(path)
    expected = [[2892.33, 0, 823.205], [0, 2883.18, 619.071], [0, 0, 1]]
    np.testing.assert_allclose(K, expected, atol=6e-3)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(-R.T @ t, [190.8, -1.16, 24.26], atol=0.05)


@pytest.mark.parametrize(
    "content, message",
    [
        ("1 2 3 4\n5 6 7 8\n", "8 into shape"),
        ("P = 1 2\n" * 3, "not convert string"),
        ("1 0 0 0\n0 1 0 0\n0 0 inf 1\n", "finite numbers and an inverse"),
        ("1 0 0 0\n0 1 0 0\n1 1 0 1\n", "finite numbers and an inverse"),
    ],
)
def test_a_bad_file_is_an_error_with_its_path(tmp_path, content, message):
    path = tmp_path / "calibration.txt"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read_projection(path)
    assert str(caught.value).startswith(f"{path} cannot be read as a calibration")
