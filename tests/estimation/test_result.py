"""What a pose has in other forms: its inverse, and as values of JSON and back."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from results import ambiguous_pose
from scenes import SceneKind, two_view_scene
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.status import STATUSES, Status

FAST = EstimationOptions(runs=1)


def scene_pose(kind: SceneKind = "general", **deviations: float) -> RelativePose:
    scene = two_view_scene(kind, seed=1, count=300)
    cameras = (replace(camera, **deviations) for camera in scene.cameras)
    return estimate_pose(scene.matches, *cameras, FAST)


def test_the_forms_of_a_pose() -> None:
    pose = scene_pose()
    point = np.array([0.3, -0.2, 4.0])
    by_matrix = pose.matrix() @ np.append(point, 1)
    np.testing.assert_allclose(by_matrix, [*(pose.R @ point + pose.t), 1])
    np.testing.assert_allclose(pose.R @ pose.centre + pose.t, 0, atol=1e-12)
    rotation = Rotation.from_matrix(pose.R)
    np.testing.assert_allclose(pose.rotvec, rotation.as_rotvec(), atol=1e-9)
    wxyz = np.roll(rotation.as_quat(canonical=True), 1)
    np.testing.assert_allclose(pose.quaternion_wxyz, wxyz, atol=1e-9)
    turned = scene_pose("rotation_only")
    assert turned.rotvec is not None and turned.matrix() is None and turned.centre is None
    assert scene_pose("random").rotvec is None


def inverted(R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inverses of poses, R (..., 3, 3) and t (..., 3)."""
    matrix = np.zeros((*t.shape[:-1], 4, 4))
    matrix[..., :3, :3] = R
    matrix[..., :3, 3] = t
    matrix[..., 3, 3] = 1
    matrix = np.linalg.inv(matrix)
    return matrix[..., :3, :3], matrix[..., :3, 3]


@pytest.mark.parametrize("kind", ["general", "rotation_only"])
def test_the_inverse_has_the_covariance_of_inverted_poses(kind: SceneKind) -> None:
    pose = scene_pose(kind)
    inverse = pose.inverse()
    t = np.zeros(3) if pose.t is None else pose.t
    R, t_of_inverse = inverted(pose.R, t)
    np.testing.assert_allclose(inverse.R, R, atol=1e-12)
    if pose.t is not None:
        np.testing.assert_allclose(inverse.t, t_of_inverse, atol=1e-12)
        # t is perpendicular to its errors.
        np.testing.assert_allclose(inverse.covariance[3:, 3:] @ inverse.t, 0, atol=1e-12)
    # Drawn errors, small enough for the inversion to be linear.
    covariance = pose.covariance * 1e-8 / np.trace(pose.covariance)
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(6), covariance, 20_000)
    turns = Rotation.from_rotvec(drawn[:, :3]).as_matrix()
    R, moved = inverted(turns @ pose.R, t + drawn[:, 3:])
    rotations = Rotation.from_matrix(R @ inverse.R.T).as_rotvec()
    expected = replace(pose, covariance=covariance).inverse().covariance
    error = np.cov(np.column_stack([rotations, moved - t_of_inverse]).T) - expected
    assert np.abs(error).max() < 0.03 * np.abs(expected).max()
    if pose.t is None:
        assert inverse.rotation_error_90_deg == pytest.approx(pose.rotation_error_90_deg)


def test_the_inverse_of_the_inverse_is_the_pose_but_for_its_evidence() -> None:
    for pose in (scene_pose(focal_std=0.1), scene_pose("rotation_only"), ambiguous_pose()):
        inverse = pose.inverse()
        back, data = inverse.inverse().to_dict(), pose.to_dict()
        assert back.keys() == data.keys() and inverse.evidence is None
        for name, value in data.items():
            if name in ("R", "t", "covariance", "E", "quaternion_wxyz") and value is not None:
                np.testing.assert_allclose(back[name], value, atol=1e-12)
            elif name == "alternatives":
                for once, again in zip(value, back[name], strict=True):
                    np.testing.assert_allclose(once["R"], again["R"], atol=1e-12)
                    np.testing.assert_allclose(once["t"], again["t"], atol=1e-12)
            elif not name.endswith("_error_90_deg"):
                assert back[name] == value, name
        for first, second in zip(pose.hypotheses, inverse.hypotheses, strict=True):
            np.testing.assert_allclose(second.R @ first.t + second.t, 0, atol=1e-12)
    fitted = scene_pose(focal_std=0.1)
    inverse = fitted.inverse()
    assert inverse.camera1 is fitted.camera2 and inverse.camera2 is fitted.camera1
    blocks, swapped = (
        c.reshape(2, 6, 2, 6) for c in (fitted.camera_covariance, inverse.camera_covariance)
    )
    np.testing.assert_array_equal(swapped, blocks[::-1, :, ::-1])
    assert fitted.camera_covariance[0, 0] != fitted.camera_covariance[6, 6]


LENS = Camera(
    np.array([[900.0, 1, 500], [0, 910, 400], [0, 0, 1]]),
    (1000, 800),
    Distortion("RADIAL", (0.1, -0.02)),
    ("a warning",),
    *(0.02, 3.0, 0.05, "exif", "a telephone", "equirectangular", 0.01),
)


@pytest.mark.parametrize(
    "made",
    [
        scene_pose,
        lambda: scene_pose("planar"),
        lambda: scene_pose("rotation_only"),
        lambda: scene_pose("random"),
        lambda: scene_pose(focal_std=0.1, lens_std=0.05),
        lambda: replace(scene_pose(), camera1=LENS, length=1.5, length_std=0.1),
        lambda: replace(scene_pose(), warnings=("one", "two"), seconds={"load": 0.1, "quick": 1.0}),
        ambiguous_pose,
        lambda: RelativePose("too_few_matches", "few", np.zeros(3, bool), 3),
        lambda: replace(scene_pose(), probability=None, any_probability=None),
    ],
)
def test_a_pose_is_read_from_its_json(made: Callable[[], RelativePose]) -> None:
    pose = made()
    read = RelativePose.from_dict(json.loads(pose.to_json()))
    assert read.to_json() == pose.to_json()
    assert RelativePose.from_dict(pose.to_dict()).to_dict() == pose.to_dict()
    assert repr(read) == repr(pose)
    assert (read.reason, read.warnings) == (pose.reason, pose.warnings)
    np.testing.assert_array_equal(read.cam2_from_cam1, pose.cam2_from_cam1)
    np.testing.assert_array_equal(read.covariance, pose.covariance)
    assert len(read.inliers) == pose.num_inliers and read.evidence is None
    if pose.camera1 is LENS and read.camera1 is not None:
        np.testing.assert_array_equal(read.camera1.K, LENS.K)
        others = {name: value for name, value in vars(read.camera1).items() if name != "K"}
        assert others == {name: value for name, value in vars(LENS).items() if name != "K"}


@pytest.mark.parametrize(
    "change",
    [
        lambda data: 5,
        lambda data: {},
        lambda data: {**data, "status": "fine"},
        lambda data: {**data, "R": [[1, 0], [0]]},
        lambda data: {**data, "num_inliers": -1},
        lambda data: {**data, "camera1": {"K": 5}},
        lambda data: {**data, "alternatives": [{}]},
        lambda data: {**data, "status": "no_model", "warnings": []},
    ],
)
def test_what_is_no_pose_is_refused(change: Callable[[Any], Any]) -> None:
    with pytest.raises(InputError, match="^data cannot be read as a pose of to_dict"):
        RelativePose.from_dict(change(scene_pose().to_dict()))


GUIDE = Path(__file__).resolve().parents[2] / "docs" / "quick-start.md"


def test_every_status_has_its_facts_and_a_line_in_the_guide() -> None:
    assert list(STATUSES) == list(get_args(Status))
    lines = GUIDE.read_text(encoding="utf-8").splitlines()
    assert [name for line in lines for name in STATUSES if line.startswith(f"| `{name}` |")] == [
        *STATUSES
    ]
