"""KITTI's calibrations, by the readmes of its development kits.

Odometry and objects: `P0:` to `P3:`, 3x4 projections of the rectified images; raw drives:
`S_rect_00:` and `P_rect_00:` in calib_cam_to_cam.txt, the size and projection of those.
"""

from pathlib import Path

import pytest

from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.errors import InputError
from dgc_pose.images.header import Header

HEADER = Header("PNG", (640, 480))


@pytest.mark.parametrize(
    ("image", "focal"),
    [("image_2/000001.png", 502), ("image_03/data/1.png", 503), ("image_0/1.png", 500)],
)
def test_odometry_by_the_images_folder(tmp_path: Path, image: str, focal: float) -> None:
    lines = [f"P{i}: {500 + i} 0 320 {-0.5 * i} 0 {500 + i} 240 0 0 0 1 0" for i in range(4)]
    path = tmp_path / "calib.txt"
    path.write_text("\n".join([*lines, "Tr: 1 0 0"]))
    camera = read_calibration(str(path)).camera(tmp_path, image, HEADER)
    assert camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == [focal, focal, 320, 240]
    assert camera.warnings == ()


def test_another_folder_gets_the_first_with_a_warning_where_they_differ(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    for focal, count in ((500, 0), (501, 1)):
        path.write_text(
            "".join(f"P{i}: {f} 0 320 0 0 500 240 0 0 0 1 0\n" for i, f in enumerate((500, focal)))
        )
        camera = read_calibration(str(path)).camera(tmp_path, "1.png", HEADER)
        assert (camera.K[0, 0], len(camera.warnings)) == (500, count)
    assert read_calibration(f"{path}:image_1").common.K[0, 0] == 501


def test_raw_drives_state_the_size(tmp_path: Path) -> None:
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text(
        "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\nS_00: 1.392e+03 5.12e+02\n"
        "K_00: 9.8e+02 0 6.9e+02 0 9.7e+02 2.4e+02 0 0 1\nS_rect_00: 6.400e+02 4.800e+02\n"
        "P_rect_00: 5.0e+02 0 3.2e+02 0 0 5.0e+02 2.4e+02 0 0 0 1 0\n"
    )
    camera = read_calibration(str(path)).camera(tmp_path, "image_00/data/1.png", HEADER)
    assert (camera.size, camera.K[0, 0]) == ((640, 480), 500)
    with pytest.raises(InputError, match="640 x 480 pixels, the image has 1392 x 512"):
        read_calibration(str(path)).camera(tmp_path, "1.png", Header("PNG", (1392, 512)))
