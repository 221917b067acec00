"""The images of a folder, and the reasons of what is left out."""

import os
import sys
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest

from dgc_pose.images.folder import copies_of_others, search_images

_HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic"


def _save(path: Path, format: str = "JPEG") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    PIL.Image.fromarray(pixels).save(path, format)


def test_images_have_the_format_of_their_content(tmp_path: Path) -> None:
    """Hidden names are passed over."""
    formats = {"a.JPG": "JPEG", "c": "PNG", "e.txt": "TIFF", "f/g.heic": "WEBP", "i.dat": "BMP"}
    for name, format in formats.items():
        _save(tmp_path / name, format)
    for name in (".hidden.jpg", ".thumbnails/b.jpg", "f/.c.jpg"):
        _save(tmp_path / name)
    images = search_images(tmp_path)
    assert (images.names, images.left_out) == (tuple(sorted(formats)), ())


def test_what_is_left_out_is_counted_by_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    _save(tmp_path / "a.jpg")
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
    assert images.names == ("a.jpg",)
    assert sorted(images.left_out) == [
        "1 file left out (first: b.jpg): empty",
        "1 file left out (first: gone.jpg): No such file or directory",
        "1 file left out (first: h\udcfctte.png): a name that is not UTF-8",
        "1 file left out (first: pipe): no regular file",
        "2 files left out (first: cameras.bin): not an image of a known format",
        "3 files left out (first: 1.heic): HEIC, which needs pillow-heif: pip install '.[heic]'",
        "3 folders left out (first: @eaDir): previews that a device made",
    ]


def _picture(seed: int, size: tuple[int, int]) -> np.ndarray:
    """A smooth pattern (H, W, 3) uint8, with fine noise on it."""
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.integers(0, 256, (9, 12, 3), np.uint8), size)
    noise = rng.integers(-20, 21, coarse.shape)
    return np.clip(coarse + noise, 0, 255).astype(np.uint8)


def _write(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), pixels)


def test_copies_are_known_by_their_content(tmp_path: Path) -> None:
    """Downscaled ones of the same name, in other folders, also without the orientation by EXIF; and
    equal bytes under any name."""
    pixels, names = _picture(1, (801, 603)), []
    for factor in (1, 2, 4):
        size = 801 // factor, 603 // factor
        names.append(
            "images" + f"_{factor}" * (factor > 1) + f"/x.{'jpg' if factor < 4 else 'png'}"
        )
        _write(tmp_path / names[-1], cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    (tmp_path / "b.jpg").write_bytes((tmp_path / "images/x.jpg").read_bytes())
    names.append("b.jpg")
    copies = copies_of_others(tmp_path, names)
    assert copies == {"images/x.jpg", "images_2/x.jpg", "images_4/x.png"}
    assert copies_of_others(tmp_path, names[2::-1]) == {"images_2/x.jpg", "images_4/x.png"}
    exif = PIL.Image.Exif()
    exif[274] = 6
    PIL.Image.fromarray(np.rot90(pixels[..., ::-1])).save(tmp_path / "x.jpg", exif=exif)
    assert copies_of_others(tmp_path, ["images_4/x.png", "x.jpg"]) == {"images_4/x.png"}


@pytest.mark.parametrize("copy", ["x (1).jpg", "x copy.jpg", "x - Copy.jpg", "a/Copy of x.jpg"])
def test_of_equal_files_the_one_with_the_plain_name_is_kept(tmp_path: Path, copy: str) -> None:
    for name in (copy, "x.jpg"):
        _save(tmp_path / name)
    assert copies_of_others(tmp_path, [copy, "x.jpg"]) == {copy}


def test_different_photographs_are_no_copies(tmp_path: Path) -> None:
    """Of one size or not: a rig's, those of two days, a crop, and of a camera that moved by 1/50 of
    the width; nor are the same pictures of other names."""
    pixels = _picture(1, (800, 600))
    half = cv2.resize(pixels, (400, 300), interpolation=cv2.INTER_AREA)
    pictures = {
        "a/x.png": pixels,
        "b/x.png": pixels + np.uint8(1),  # as large
        "c/x.png": cv2.resize(_picture(2, (800, 600)), (400, 300)),
        "d/x.png": half[:200],
        "e/x.png": np.roll(half, 8, axis=1),
        "f/y.png": half,
        "g/x.png": np.zeros_like(half),
        "h/x.png": np.zeros((150, 200, 3), np.uint8),
    }
    for name, picture in pictures.items():
        _write(tmp_path / name, picture)
    (tmp_path / "i").mkdir()
    (tmp_path / "i" / "x.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    assert copies_of_others(tmp_path, [*pictures, "i/x.png"]) == set()


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
    assert images.left_out == ()
    link = tmp_path / "link"
    link.symlink_to(folder)
    assert search_images(link).names == images.names
