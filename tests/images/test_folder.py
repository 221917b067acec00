"""The images of a folder, the reasons of what is left out, and the frames of a video."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
from command_line import assert_refused, run
from worlds import K_text, render_views

from dgc_pose.errors import InputError
from dgc_pose.images.folder import frames_folder, identical_copies, search_images
from dgc_pose.images.image import load_image

_HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic"


def _save(path: Path, format: str = "JPEG") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    PIL.Image.fromarray(pixels).save(path, format)


def test_images_have_the_format_of_their_content_and_others_are_counted_by_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hidden names are passed over."""
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    formats = {"a.JPG": "JPEG", "c": "PNG", "e.txt": "TIFF", "f/g.heic": "WEBP", "i.dat": "BMP"}
    for name, format in formats.items():
        _save(tmp_path / name, format)
    for name in (".hidden.jpg", ".thumbnails/b.jpg", "f/.c.jpg"):
        _save(tmp_path / name)
    for name in ("3.HEIC", "1.heic", "sub/2.heic"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(_HEIC)
    (tmp_path / "notes.txt").write_text("of the day")
    _save(tmp_path / os.fsdecode("h\xfctte.png".encode("latin-1")))
    (tmp_path / "cameras.bin").write_bytes(bytes(64))
    (tmp_path / "b.jpg").touch()
    (tmp_path / "gone.jpg").symlink_to(tmp_path / "nowhere")
    os.mkfifo(tmp_path / "pipe")
    for name in ("@eaDir/a.jpg/SYNOPHOTO.jpg", "sub/Thumbs/1.jpg", "__MACOSX/b.jpg"):
        _save(tmp_path / name)
    images = search_images(tmp_path)
    assert images.names == tuple(sorted(formats))
    assert sorted(images.skipped) == [
        "1 file skipped (first: h\udcfctte.png): a name that is not UTF-8",
        "1 file skipped (first: pipe): not a regular file",
        "2 files skipped (first: cameras.bin): not an image of a known format",
        "3 files skipped (first: 1.heic): HEIC, which needs pillow-heif: pip install '.[heic]'",
        "3 folders skipped (first: @eaDir): previews that a device made",
    ]
    assert images.bad == {"b.jpg": "empty", "gone.jpg": "No such file or directory"}


def test_equal_bytes_are_copies_under_any_name(tmp_path: Path) -> None:
    """The shortest name is kept. Files of one size and other bytes are no copies."""
    for name in ("images/x.jpg", "b.jpg", "a/Copy of x.jpg"):
        _save(tmp_path / name)
    for name in ("a/y.bmp", "b/y.bmp"):
        _save(tmp_path / name, "BMP")
    data = (tmp_path / "a/y.bmp").read_bytes()
    (tmp_path / "a/y.bmp").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    names = search_images(tmp_path).names
    assert identical_copies(tmp_path, names) == {"a/Copy of x.jpg", "images/x.jpg"}


def test_linked_folders_are_searched_once(tmp_path: Path) -> None:
    """A file has the name of the folder that it lies in, and a loop of links comes to an end."""
    elsewhere = tmp_path / "elsewhere"
    _save(elsewhere / "deep" / "b.jpg")
    folder = tmp_path / "folder"
    _save(folder / "z" / "a.jpg")
    (folder / "all").symlink_to(folder)
    (folder / "before").symlink_to(folder / "z")
    (folder / "other").symlink_to(elsewhere)
    (folder / "other2").symlink_to(elsewhere)
    (elsewhere / "back").symlink_to(folder)
    (folder / "file").symlink_to(folder / "z" / "a.jpg")
    images = search_images(folder)
    assert images.names == ("file", "other/deep/b.jpg", "z/a.jpg")
    assert images.skipped == ()
    link = tmp_path / "link"
    link.symlink_to(folder)
    assert search_images(link).names == images.names


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


def test_the_sharpest_frame_of_each_part_is_taken_once(tmp_path: Path) -> None:
    """And anew of another video. The folder may lie in one that is still missing."""
    video = tmp_path / "a.avi"
    folder = tmp_path / "new" / "frames"
    write_video(video, _frames(30, {2, 13, 14, 25}))
    assert frames_folder(video, 3, folder) == folder
    assert _numbers(folder) in ([2, 13, 25], [2, 14, 25])
    before = {file: file.stat() for file in folder.iterdir()}
    assert {file: file.stat() for file in frames_folder(video, 3, folder).iterdir()} == before
    write_video(video, _frames(8, {3, 6}))
    os.utime(video, (1e9, 1e9))
    assert _numbers(frames_folder(video, 2, folder)) == [3, 6]
    for name in ("folder.mp4", "missing.mp4", "pairs.txt"):
        assert frames_folder(tmp_path / name, 40, tmp_path / "frames") == tmp_path / name


def test_a_video_without_a_frame(tmp_path: Path) -> None:
    """Nothing is written. In a process of its own FFmpeg prints nothing beside our line."""
    name = "x1.mp4"
    (tmp_path / name).write_bytes(b"\0\0\0\x18ftypmp42" + bytes(100))
    message = f"{tmp_path / name} is not a video that can be read"
    with pytest.raises(InputError) as caught:
        frames_folder(tmp_path / name, 40, tmp_path / "frames")
    assert str(caught.value) == message
    command = [sys.executable, "-m", "dgc_pose", "batch", tmp_path / name, "--out", tmp_path / "o"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"error: {message}\n")
    assert os.listdir(tmp_path) == [name]


def test_a_video_is_a_source(tmp_path: Path) -> None:
    """Its frames are photographs for a resumed batch too."""
    views = [view.pixels for view in render_views(3)]
    write_video(tmp_path / "scene.avi", [frame for view in views for frame in (view, view)])
    options = ["--K", K_text(), "--weights", "sift", "--workers", "1", "--frames", "3"]
    options += ["--runs", "1", "--iterations", "300"]
    command_line = ("reconstruct", tmp_path / "scene.avi", "--out", tmp_path / "out", *options)
    done = run(*command_line)
    assert done.exit_code == 0, done.output
    frames = tmp_path / "out" / "batch_3_frames_of_scene.avi"
    assert [load_image(file).size for file in frames.iterdir()] == 3 * [(240, 180)]
    assert_refused(run(*command_line), "--resume")
    again = run(*command_line, "--resume")
    assert again.exit_code == 0 and "3 poses of 3 pairs" in again.output, again.output
