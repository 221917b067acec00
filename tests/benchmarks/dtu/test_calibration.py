import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.dtu.calibration import DtuView, read_projection, relative_pose
from dgc_pose.errors import InputError

# The first position of DTU's calibration, as published.
POS_001 = """2607.429996 -3.844898 1498.178098 -533936.661373
-192.076910 2862.552532 681.798177 23434.686572
-0.241605 -0.030951 0.969881 22.540121
"""
K = np.array([[2892.0, 0.5, 823.0], [0.0, 2883.0, 619.0], [0.0, 0.0, 1.0]])


def random_view(seed):
    rng = np.random.default_rng(seed)
    return DtuView(K, Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3) * 500)


def test_the_published_first_position(tmp_path):
    path = tmp_path / "pos_001.txt"
    path.write_text(POS_001)
    view = read_projection(path)
    assert np.allclose(view.K, [[2892.33, 0, 823.205], [0, 2883.18, 619.071], [0, 0, 1]], atol=6e-3)
    assert np.linalg.det(view.R) == pytest.approx(1, abs=1e-9)
    centre = -view.R.T @ view.t
    assert np.allclose(centre, [190.8, -1.16, 24.26], atol=0.05)


@pytest.mark.parametrize("scale", [1.0, -1.0, 1e-3, -250.0])
@pytest.mark.parametrize("seed", range(4))
def test_any_scale_of_a_projection_matrix_gives_its_camera(tmp_path, seed, scale):
    view = random_view(seed)
    np.savetxt(tmp_path / "P", scale * view.K @ np.column_stack([view.R, view.t]))
    found = read_projection(tmp_path / "P")
    assert np.allclose(found.K, view.K, atol=1e-8)
    assert np.allclose(found.R, view.R, atol=1e-11)
    assert np.allclose(found.t, view.t, atol=1e-8)


def test_relative_pose_moves_points_from_one_camera_to_the_other():
    view1, view2 = random_view(1), random_view(2)
    R, t = relative_pose(view1, view2)
    world = np.random.default_rng(0).normal(size=(10, 3)) * 300
    for point in world:
        in1 = view1.R @ point + view1.t
        in2 = view2.R @ point + view2.t
        assert np.allclose(R @ in1 + t, in2, atol=1e-9)


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
    assert str(caught.value).startswith(f"{path} is not a calibration")
