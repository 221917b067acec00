"""A projection matrix as DTU publishes it, and damaged ones."""

import numpy as np
import pytest

from dgc_pose.benchmarks.dtu.calibration import read_projection
from dgc_pose.errors import InputError

# The first position of DTU's calibration, as published.
POS_001 = """2607.429996 -3.844898 1498.178098 -533936.661373
-192.076910 2862.552532 681.798177 23434.686572
-0.241605 -0.030951 0.969881 22.540121
"""


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
