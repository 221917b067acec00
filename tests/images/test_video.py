"""The frames of a video: which are taken, when, and of what."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import assert_refused, run
from worlds import K_text, render_views

from dgc_pose.errors import InputError
from dgc_pose.images.video import frames_folder
from dgc_pose.pose import load_image

SIZE = (160, 96)


def write_video(path: Path, frames: list[np.ndarray]) -> None:
    """Motion JPEG of images (H, W, 3), RGB."""
    size = frames[0].shape[1], frames[0].shape[0]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, size)
    for frame in frames:
        video.write(np.ascontiguousarray(frame[:, :, ::-1]))
    video.release()


def _frames(count: int, sharp: set[int]) -> list[np.ndarray]:
    """Stripes, blurred but for some frames. The mean grey is 40 and five times the number."""
    stripes = 20 * (np.arange(SIZE[0]) // 8 % 2 * 2.0 - 1) + np.zeros((SIZE[1], 1))
    blurred = cv2.GaussianBlur(stripes, (0, 0), 4)
    pictures = (40 + 5 * i + (stripes if i in sharp else blurred) for i in range(count))
    return [np.repeat(np.uint8(picture)[:, :, None], 3, 2) for picture in pictures]


def _numbers(folder: Path) -> list[int]:
    return [round((load_image(f).pixels.mean() - 40) / 5) for f in sorted(folder.iterdir())]


@pytest.mark.parametrize("name", ["a.avi", "a.dat"])
def test_the_sharpest_frame_of_each_part_is_taken(tmp_path: Path, name: str) -> None:
    """Whatever the name ends in; the folder may lie in one that is still missing."""
    write_video(tmp_path / "a.avi", _frames(30, {2, 13, 14, 25}))
    video = (tmp_path / "a.avi").rename(tmp_path / name)
    folder = tmp_path / "new" / "frames"
    assert frames_folder(video, 3, folder) == folder
    assert _numbers(folder) in ([2, 13, 25], [2, 14, 25])
    assert load_image(sorted(folder.iterdir())[0]).size == SIZE


def test_frames_are_taken_once_and_anew_of_another_video(tmp_path: Path) -> None:
    video, folder = tmp_path / "a.avi", tmp_path / "frames"
    write_video(video, _frames(8, {1, 5}))
    before = {file: file.stat() for file in frames_folder(video, 2, folder).iterdir()}
    assert {file: file.stat() for file in frames_folder(video, 2, folder).iterdir()} == before
    write_video(video, _frames(8, {3, 6}))
    os.utime(video, (1e9, 1e9))
    assert _numbers(frames_folder(video, 2, folder)) == [3, 6]


@pytest.mark.parametrize(("name", "start"), [("x1.mp4", b"\0\0\0\x18ftypmp42"), ("a.mkv", b"a b")])
def test_a_video_without_a_frame(tmp_path: Path, name: str, start: bytes) -> None:
    """Nothing is written. In a process of its own FFmpeg prints nothing beside our line."""
    (tmp_path / name).write_bytes(start + bytes(100))
    message = f"{tmp_path / name}: no frame of this video can be read"
    with pytest.raises(InputError) as caught:
        frames_folder(tmp_path / name, 40, tmp_path / "frames")
    assert str(caught.value) == message
    command = [sys.executable, "-m", "dgc_pose", "batch", tmp_path / name, "--out", tmp_path / "o"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"error: {message}\n")
    assert os.listdir(tmp_path) == [name]


def test_what_is_no_video_stays(tmp_path: Path) -> None:
    (tmp_path / "pairs.txt").write_text("a.jpg b.jpg\n")
    (tmp_path / "folder.mp4").mkdir()
    for name in ("pairs.txt", "folder.mp4", "missing.mp4"):
        assert frames_folder(tmp_path / name, 40, tmp_path / "frames") == tmp_path / name
    assert not (tmp_path / "frames").exists()


def test_a_video_is_a_source(tmp_path: Path) -> None:
    """Its frames are photographs for a resumed batch too."""
    views = [view.pixels for view in render_views(4)]
    write_video(tmp_path / "scene.avi", [frame for view in views for frame in (view, view)])
    options = ["--K", K_text(), "--weights", "sift", "--workers", "1", "--frames", "4"]
    command_line = ("reconstruct", tmp_path / "scene.avi", "--out", tmp_path / "out", *options)
    done = run(*command_line)
    assert done.exit_code == 0, done.output
    frames = tmp_path / "out" / "batch_4_frames_of_scene.avi"
    assert [load_image(file).size for file in frames.iterdir()] == 4 * [(240, 180)]
    assert_refused(run(*command_line), "--resume")
    again = run(*command_line, "--resume")
    assert again.exit_code == 0 and "6 poses of 6 pairs" in again.output, again.output
