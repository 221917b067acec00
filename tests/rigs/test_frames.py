"""The frames of fixed cameras by their names, and the still picture of each."""

import os
import unicodedata
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from bad_pictures import BAD_PICTURES, write_bad_pictures
from marker_scene import texture

from dgc_pose.errors import ImageError, InputError
from dgc_pose.images.decoding import read_pixels
from dgc_pose.images.image import load_image
from dgc_pose.rigs.frames import camera_frames, still_picture, still_pictures

SIZE = (160, 120)
SCENE = np.stack([texture(SIZE, seed) for seed in range(3)], -1)  # not brighter than 200


def save(path: Path, pixels: np.ndarray = SCENE, orientation: int = 1) -> Path:
    exif = PIL.Image.Exif()
    exif[274] = orientation
    path.parent.mkdir(parents=True, exist_ok=True)
    PIL.Image.fromarray(pixels).save(path, exif=exif)
    return path


def still(folder: Path, name: str, *paths: Path) -> Path:
    """The still picture of a camera with these frames."""
    return still_picture({path: load_image(path) for path in paths}, name, folder, folder)[0]


def test_an_entry_of_the_folder_is_a_camera(tmp_path: Path) -> None:
    """An image by its content, and a folder of frames, of which at most 15 are read."""
    rig = tmp_path / "rig"
    save(rig / "north.jpg")
    save(rig / "south.png", SCENE[::-1]).rename(rig / "south.data")
    many = [save(rig / "west" / f"{number:02d}.png") for number in range(40)]
    (rig / "notes.txt").write_text("of the cameras")
    (rig / "empty").mkdir()
    found = camera_frames(rig, tmp_path / "videos")
    assert found.skipped[0].startswith("2 files skipped (first: empty): neither a picture")
    expected = {"north": [rig / "north.jpg"], "south": [rig / "south.data"], "west": many[::3]}
    assert found.frames == expected and not (tmp_path / "videos").exists()


def test_what_is_no_rig_is_refused(tmp_path: Path) -> None:
    """One camera, one camera twice, and two of a name, each with the path. Two black pictures are
    equal, and not of one camera."""
    rig, videos = tmp_path / "rig", tmp_path / "videos"
    save(rig / "a.png")
    with pytest.raises(InputError, match="rig: 1 cameras found, and a rig has two$"):
        camera_frames(rig, videos)
    save(rig / "b.png")
    with pytest.raises(InputError, match=r"b\.png is the picture of another camera$"):
        still_pictures(camera_frames(rig, videos), tmp_path, tmp_path)
    for name in "ab":
        save(rig / f"{name}.png", 0 * SCENE)
    assert {*still_pictures(camera_frames(rig, videos), tmp_path, tmp_path).bad} == {"a", "b"}
    (rig / "b.png").unlink()
    save(rig / "a" / "0.png")
    with pytest.raises(InputError, match="rig: two cameras have the name a$"):
        camera_frames(rig, videos)
    for name in ("cameras", "metadata"):
        save(tmp_path / name / f"{name}.png")
        with pytest.raises(InputError, match=f"{name}\\.png: the files of a rig have no camera of"):
            camera_frames(tmp_path / name, videos)


def test_a_single_picture_is_copied_and_a_turned_one_is_upright(tmp_path: Path) -> None:
    path = save(tmp_path / "a.jpg")
    copied = still(tmp_path, "cam", path)
    assert copied.name == "cam.jpg" and copied.read_bytes() == path.read_bytes()
    turned = still(tmp_path, "turned", save(tmp_path / "b.png", np.rot90(SCENE), 6))
    np.testing.assert_array_equal(load_image(turned).pixels, SCENE)
    assert load_image(turned).exif.orientation == 1


def test_the_picture_is_without_what_moves_and_the_mask_black_there(tmp_path: Path) -> None:
    """A thing that passes, and a flag in 3 of 8 frames; light that changes moves nothing."""
    rng, paths = np.random.default_rng(0), []
    for number in range(8):
        pixels = SCENE // 2 + 5 * number + rng.normal(0, 2, SCENE.shape)
        pixels[90:110, 20 * number : 20 * number + 20] = 255
        if number % 3 == 0:
            pixels[20:50, 60:100] = 255
        paths.append(save(tmp_path / "frames" / f"{number}.png", pixels.astype(np.uint8)))
    picture = still(tmp_path, "cam.1", *paths)
    assert picture.name == "cam.1.png"
    mask = read_pixels(tmp_path / "cam.1.png.png")
    assert (mask[24:46, 64:96] == 0).all()
    mask[18:52, 58:102] = 255
    assert (mask == 255).mean() > 0.99
    off = load_image(picture).pixels - (SCENE // 2 + 17.5)
    assert np.abs(off).mean() < 4 and np.abs(off).max() < 25


def shifted(pixels: int) -> np.ndarray:
    """The scene, by a camera that turned: what leaves the picture on a side enters on the other."""
    return np.roll(SCENE, pixels, axis=1)


def test_frames_of_a_camera_that_was_moved_are_left_out(tmp_path: Path) -> None:
    """By a sentence with what is observed; without a majority there is no picture."""
    frames = tmp_path / "rig" / "door"
    for number, shift in enumerate((0, 0, 6, 0, 6)):
        save(frames / f"{number}.png", shifted(shift))
    save(tmp_path / "rig" / "desk.png", SCENE[::-1])
    stills = still_pictures(camera_frames(tmp_path / "rig", tmp_path), tmp_path, tmp_path)
    (line,) = stills.lines
    assert line.endswith(": the 3 of 5 frames in one position are used") and str(frames) in line
    np.testing.assert_array_equal(load_image(stills.pictures["door"]).pixels, SCENE)
    for number in range(5):
        save(frames / f"{number}.png", shifted(3 * number))
    stills = still_pictures(camera_frames(tmp_path / "rig", tmp_path), tmp_path, tmp_path)
    assert {*stills.pictures} == {"desk"}
    assert stills.bad["door"].endswith(", and no position has most of the 5 frames")


def test_names_may_have_blanks_dots_and_composed_letters(tmp_path: Path) -> None:
    """A folder has no ending. A name may be stored with its letters decomposed, as macOS does, and
    one that is no UTF-8 fits into no file of a rig."""
    rig = tmp_path / "rig"
    save(rig / unicodedata.normalize("NFD", "Kamera.2 süd.jpg"))
    save(rig / "door.v2" / "0.png", SCENE[::-1])
    save(rig / os.fsdecode(b"caf\xe9") / "0.png", SCENE[:, ::-1])
    found = camera_frames(rig, tmp_path / "videos")
    assert {*found.frames} == {"Kamera.2 süd", "door.v2"}
    assert found.skipped == (r"'caf\udce9' skipped: a name that is not UTF-8",)
    stills = still_pictures(found, tmp_path, tmp_path)
    assert {path.name for path in stills.pictures.values()} == {"Kamera.2 süd.jpg", "door.v2.png"}


def test_frames_that_give_no_picture_are_refused(tmp_path: Path) -> None:
    """Without what moves, nothing may be left, or a single colour."""
    other = [save(tmp_path / "a" / "0.png"), save(tmp_path / "a" / "1.png", SCENE[:100])]
    with pytest.raises(InputError, match="a: frames of several sizes$"):
        still(tmp_path, "cam", *other)
    with pytest.raises(
        ImageError, match=r"black\.png: the grey levels differ by 0\.00 .*, and 2 are needed$"
    ):
        still(tmp_path, "cam", save(tmp_path / "black.png", 0 * SCENE))
    moved = [np.stack([texture(SIZE, 10 * n + k) for k in range(3)], -1) for n in range(5)]
    paths = [save(tmp_path / "m" / f"{n}.png", pixels) for n, pixels in enumerate(moved)]
    with pytest.raises(InputError, match="m: everything moves between the 5 frames$"):
        still(tmp_path, "cam", *paths)
    for path, pixels in zip(paths, moved, strict=True):
        save(path, np.hstack([np.full_like(SCENE, 90)[:, :100], pixels[:, 100:]]))
    with pytest.raises(
        ImageError, match=r"0\.png: the grey levels .* where the picture is not masked, and 2 "
    ):
        still(tmp_path, "cam", *paths)
    assert not [*tmp_path.glob("cam*")]


def test_files_that_cannot_be_read_displace_no_other(tmp_path: Path) -> None:
    """Neither frames of a folder, of which at most 15 are read, nor a file of the same name."""
    rig = tmp_path / "rig"
    fine = [save(rig / "many" / f"{number:02d}.png") for number in range(15)]
    empty = [path.with_suffix(".jpg") for path in fine] + [rig / "south.jpg", rig / "south.tif"]
    south = save(rig / "south.png", SCENE[::-1])
    for path in empty:
        path.write_bytes(b"")
    (rig / "south.mp4").write_text("not a video")
    found = camera_frames(rig, tmp_path / "videos")
    assert found.frames == {"many": fine, "south": [south]}
    stills = still_pictures(found, tmp_path, tmp_path)
    assert {*stills.pictures} == {*found.frames} and not stills.bad
    no_video = f"{rig / 'south.mp4'} is not a video that can be read"
    assert {*stills.lines} == {no_video, *(f"{path}: empty" for path in empty)}


def test_bad_pictures_are_told_and_the_others_are_there(tmp_path: Path) -> None:
    """Cameras with one bad picture, or a video that is none; and bad frames of a camera."""
    rig = tmp_path / "rig"
    bad = [path for path in write_bad_pictures(rig) if path.exists()]
    (rig / "video.mp4").write_text("not a video")
    save(rig / "fine.png")
    frames = write_bad_pictures(rig / "many", SCENE.shape[1::-1])
    for path in frames:
        if path.name in ("tiny.png", "grey.png", "missing.jpg"):  # these can be read
            path.unlink(missing_ok=True)
    save(rig / "many" / "9.png", SCENE[::-1])
    write_bad_pictures(rig / "none")
    for name in ("tiny.png", "grey.png", "clear.png"):
        (rig / "none" / name).unlink()
    found = camera_frames(rig, tmp_path / "videos")
    assert not found.skipped
    stills = still_pictures(found, tmp_path, tmp_path)
    reasons = stills.bad
    assert {*stills.pictures} == {"fine", "many"}
    assert {*reasons} == {path.stem for path in bad} | {"video", "none"}
    for path in bad:
        assert BAD_PICTURES[path.name] in reasons[path.stem]
    assert reasons["video"] == f"{rig / 'video.mp4'} is not a video that can be read"
    left_out = [path for path in frames if path.exists()]
    told = [line for line in stills.lines if str(rig / "many") in line]
    assert len(told) == len(left_out)
    assert all(any(str(path) in line for line in told) for path in left_out)
    np.testing.assert_array_equal(load_image(stills.pictures["many"]).pixels, SCENE[::-1])
