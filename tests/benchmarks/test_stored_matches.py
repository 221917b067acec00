"""Files of other programs: every format gives the map that it was written from."""

import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from dgc_pose.benchmarks.other_matchers import FileMatcher, pair_files
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image
from dgc_pose.matching import CorrespondenceMap, MatchingOptions

STORED = (80, 60)  # width, height of both views as stored
SHOWN = (40, 20)  # and as shown to the methods
STEM = "scan65_3_7"


def _images(size: tuple[int, int] = SHOWN) -> tuple[Image, Image]:
    """Both views, stored at 80x60 and shown at `size`."""
    blots = np.random.default_rng(0).integers(0, 255, (12, 16, 3), np.uint8)
    pixels = cv2.resize(blots, size, interpolation=cv2.INTER_CUBIC)
    return Image(pixels, "3.png", stored_size=STORED), Image(pixels, "7.png", stored_size=STORED)


def _matcher(folder: Path) -> FileMatcher:
    return FileMatcher(
        "mine", {("3.png", "7.png"): next(folder.glob(f"{STEM}.*"))}, MatchingOptions()
    )


def _map(folder: Path, size: tuple[int, int] = SHOWN) -> CorrespondenceMap:
    found = _matcher(folder).match(*_images(size)).correspondence_map
    assert found is not None
    return found


def _flow(size: tuple[int, int] = STORED) -> np.ndarray:
    """Smooth."""
    x, y = np.moveaxis(pixel_grid(size), -1, 0)
    return np.stack([3 + 0.05 * x - 0.02 * y, -2 + 0.04 * y], -1)


def _write_flo(path: Path, flow: np.ndarray) -> None:
    """As Middlebury's page describes the format."""
    height, width = flow.shape[:2]
    with path.open("wb") as stream:
        stream.write(struct.pack("<fii", 202021.25, width, height))
        for row in flow:
            for u, v in row:
                stream.write(struct.pack("<ff", u, v))


WRITERS = {
    "flow.flo": lambda path, flow: _write_flo(path, np.nan_to_num(flow, nan=1e10)),
    "flow.npy": np.save,
    "flow.npz": lambda path, flow: np.savez(path, flow=flow),
    "map.npz": lambda path, flow: np.savez(path, map=pixel_grid(STORED) + flow),
    "grid.npz": lambda path, flow: np.savez(
        path, map=pixel_grid(STORED) + flow, grid=pixel_grid(STORED)
    ),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_format_gives_the_points_of_its_flow(tmp_path, writer) -> None:
    """Each cell's point is its centre moved by the flow there, in pixels of the shown images."""
    flow = _flow()
    flow[10:14, 20:25] = np.nan
    WRITERS[writer](tmp_path / f"{STEM}{Path(writer).suffix}", flow)
    found = _map(tmp_path)
    assert (found.size1, found.size2) == (SHOWN, SHOWN)
    assert found.matchability.shape == (20, 27)  # every third cell, the images shown being 40 x 20
    scale = np.divide(SHOWN, STORED)
    unknown = 0
    for point, cell, matchability in zip(
        found.map.reshape(-1, 2), found.grid.reshape(-1, 2), found.matchability.ravel(), strict=True
    ):
        x, y = np.rint((cell + 0.5) / scale - 0.5).astype(int)
        if np.isnan(flow[y, x]).any():
            unknown += 1
            assert matchability == 0 and np.isneginf(point).all()
        else:
            expected = (np.array([x, y]) + flow[y, x] + 0.5) * scale - 0.5
            assert matchability == 1 and np.allclose(point, expected, atol=1e-4)
    assert unknown > 0


def test_points_are_given_in_pixels_of_the_images_shown(tmp_path) -> None:
    points1 = np.array([[20.5, 20.5], [58.5, 38.5], [39.5, 29.5]])
    np.savez(tmp_path / f"{STEM}.npz", points1=points1, points2=points1[::-1], error_px=3.0)
    result = _matcher(tmp_path).match(*_images())
    assert result.correspondence_map is None
    found = result.matches
    assert np.allclose(found.points1, [[10, 6.5], [29, 12.5], [19.5, 9.5]])
    assert np.allclose(found.points2, found.points1[::-1])
    assert found.error_px == pytest.approx(3.0 * np.sqrt(0.5 / 3))
    assert np.array_equal(found.confidence, np.ones(3))
    assert not found.key_points
    np.savez(tmp_path / f"{STEM}.npz", points1=points1, points2=points1, key_points=True)
    assert _matcher(tmp_path).match(*_images()).matches.key_points


def _bad_archive(**arrays: np.ndarray):
    return lambda path: np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("suffix", "write", "reason"),
    [
        (".flo", lambda path: path.write_bytes(b"FLOW" + b"\0" * 8), "202021.25"),
        (
            ".flo",
            lambda path: _write_flo(path, _flow()) or _cut(path),
            "cannot be read as a map, a flow",
        ),
        (".npy", lambda path: np.save(path, np.zeros((4, 5, 3))), r"\(H, W, 2\)"),
        (".npz", _bad_archive(other=np.zeros(3)), "found other"),
        (
            ".npz",
            _bad_archive(flow=np.zeros((4, 5, 2)), matchability=np.full((4, 5), 2.0)),
            "0 to 1",
        ),
        (".npz", _bad_archive(map=np.zeros((4, 5, 2)), grid=np.zeros((4, 4, 2))), "grid"),
        (".npz", _bad_archive(points1=np.zeros((4, 2)), points2=np.zeros((3, 2))), "length"),
    ],
)
def test_a_malformed_file_is_named(tmp_path, suffix, write, reason) -> None:
    path = tmp_path / f"{STEM}{suffix}"
    write(path)
    with pytest.raises(InputError, match=reason) as caught:
        _matcher(tmp_path).match(*_images())
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-8])


def test_each_pair_needs_one_file(tmp_path) -> None:
    camera = Camera(np.diag([90.0, 90, 1]))
    first = Pair("a/3.png", "a/7.png", tmp_path, camera, camera, np.eye(3), np.ones(3))
    file = tmp_path / "a-3.png_a-7.png.npy"
    np.save(file, _flow())
    paths = (str(tmp_path / "a/3.png"), str(tmp_path / "a/7.png"))
    assert pair_files(tmp_path, [first]) == {paths: file}
    with pytest.raises(InputError, match=r"a-7.png_a-3.png: no files .*\.flo"):
        pair_files(tmp_path, [first, replace(first, name1="a/7.png", name2="a/3.png")])
    np.savez(file.with_suffix(".npz"), flow=_flow())
    with pytest.raises(InputError, match="2 files"):
        pair_files(tmp_path, [first])


def test_matchability_of_a_file_is_kept(tmp_path) -> None:
    values = np.random.default_rng(0).random((60, 80)).astype(np.float32)
    np.savez(tmp_path / f"{STEM}.npz", flow=_flow(), matchability=values)
    assert np.array_equal(_map(tmp_path, STORED).matchability, values)
