"""An older calibration against a new one: which cameras moved."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.localization.location import Location
from dgc_pose.rigs.files import compared

STD = 2e-4  # of each axis of the rotations, radians, and of the centres
Poses = dict[str, tuple[np.ndarray, np.ndarray]]  # R and centre
CAMERA = Camera(np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), (640, 480))


def poses(count: int, seed: int = 0) -> Poses:
    rng = np.random.default_rng(seed)
    return {
        f"cam{n}": (Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
        for n in range(count)
    }


def located(cameras: Poses, seed: int = 1) -> dict[str, Location]:
    """With errors of the stated covariance."""
    rng = np.random.default_rng(seed)
    found = {}
    for name, (R, centre) in cameras.items():
        R = Rotation.from_rotvec(rng.normal(0, STD, 3)).as_matrix() @ R
        at = {"R": R, "centre": centre + rng.normal(0, STD, 3), "covariance": STD**2 * np.eye(6)}
        found[name] = Location("located", "", (), camera=CAMERA, **at)
    return found


def stated(cameras: Poses, seed: int = 2) -> dict[str, np.ndarray]:
    """cam_from_world in another frame and unit."""
    W = Rotation.random(random_state=seed).as_matrix()
    found = {}
    for name, (R, centre) in cameras.items():
        found[name] = np.column_stack([R @ W.T, -R @ W.T @ (7 * W @ centre + (1, 2, 3))])
    return found


@pytest.mark.parametrize("count", [3, 4, 8])
@pytest.mark.parametrize("seed", range(5))
def test_the_camera_that_was_turned_and_shifted(count: int, seed: int) -> None:
    before = poses(count, seed)
    after = dict(before)
    R, centre = before["cam1"]
    turn = Rotation.from_rotvec(np.radians([0, 0.4, 0.3])).as_matrix()
    after["cam1"] = turn @ R, centre + (0.03, 0, 0.04)
    changes = compared(stated(before), located(after), {"cam1": CAMERA.with_focal(490)})
    assert [change.name for change in changes] == [*before]
    assert [change.moved for change in changes] == [name == "cam1" for name in before]
    change = changes[1]
    assert abs(change.angle_deg - 0.5) < 0.1 and abs(change.distance - 0.05) < 0.005
    assert change.angle_error_deg == pytest.approx(np.degrees(STD) * np.sqrt(6.251), rel=1e-3)
    assert change.focal_change == pytest.approx(100 * (500 / 490 - 1))
    assert changes[0].focal_change is None and change.relative_to is None


def test_cameras_that_stayed_did_not_move() -> None:
    """Also by exact poses, and with a covariance that is not known."""
    false = 0
    for seed in range(30):
        before = poses(4, seed)
        false += sum(change.moved for change in compared(stated(before), located(before, seed), {}))
    assert false <= 1
    exact = {n: Location("located", "", (), R=R, centre=c) for n, (R, c) in poses(4).items()}
    changes = compared(stated(poses(4)), exact, {})
    assert not any(change.moved for change in changes)
    assert {(change.angle_error_deg, change.focal_change) for change in changes} == {(0, None)}


def test_of_two_cameras_the_second_is_relative_to_the_first() -> None:
    before = poses(2)
    (unmoved,) = compared(stated(before), located(before), {})
    assert (unmoved.name, unmoved.relative_to, unmoved.moved) == ("cam1", "cam0", False)
    assert unmoved.angle_error_deg == pytest.approx(np.degrees(STD) * np.sqrt(2 * 6.251), rel=1e-3)
    R, centre = before["cam0"]
    turn = Rotation.from_rotvec(np.radians([0, 1, 0])).as_matrix()
    (moved,) = compared(stated(before), located({**before, "cam0": (turn @ R, centre)}), {})
    assert moved.moved and abs(moved.angle_deg - 1) < 0.1


def test_two_cameras_are_needed() -> None:
    with pytest.raises(InputError, match="^start has 1 of the 3 cameras, and two are needed$"):
        compared(stated(poses(1)), located(poses(3)), {})
