"""Faults that were seen once, each by its name: readers, weights, the library's arguments."""

from __future__ import annotations

import io
import os
import signal
import zipfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
import torch
import verdict_folder
from fuzz.bad_values import png_claiming
from safetensors.torch import save_file

from dgc_pose import estimate_relative_pose, load_image, load_matcher
from dgc_pose.benchmarks.scores import PairScore
from dgc_pose.benchmarks.store import RunStore
from dgc_pose.cameras.camera import guess_camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.errors import DgcPoseError, ImageError, InputError, WeightsError
from dgc_pose.estimation import EstimationOptions, VerdictOptions
from dgc_pose.files.arrays import ARRAY_BYTES, read_array, read_arrays
from dgc_pose.files.inputs import read_bytes
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network, save_weights
from dgc_pose.synthesis.photos import load_photos
from dgc_pose.training.initialise import initialise_backbone


@pytest.fixture(autouse=True)
def no_hang() -> Iterator[None]:
    """A test that waits for a pipe fails instead."""

    def give_up(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(100)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("read", [load_image, read_pairs, read_bytes, read_array, load_network])
@pytest.mark.parametrize("kind", ["fifo", "/dev/zero", "folder"])
def test_only_regular_files_are_opened(read, kind: str, tmp_path: Path) -> None:
    path = tmp_path / kind if kind[0] != "/" else Path(kind)
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    with pytest.raises((DgcPoseError, OSError)) as caught:
        read(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        [1, 2],
        {1: torch.zeros(2)},
        {"a": 3},
        {"state_dict": 5},
        {"state_dict": {"a": None}},
        torch.zeros(3),
        None,
        {"a": torch.zeros(2, dtype=torch.complex64)},
        {"a": torch.zeros(2, 2).to_sparse()},
    ],
    ids=str,
)
@pytest.mark.parametrize("packed", [True, False])
def test_a_foreign_checkpoint_is_refused(content: object, packed: bool, tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    torch.save(content, path, _use_new_zipfile_serialization=packed)
    with pytest.raises(WeightsError, match=r"w\.pth"):
        load_network(path)
    net = DGCNet(preset("dgcm-lite0"))
    with pytest.raises(WeightsError, match=r"w\.pth"):
        initialise_backbone(path, net, torch.zeros(1, 3, 240, 240))


class _Code:
    def __reduce__(self) -> tuple:
        return (os.mkdir, ("executed",))


def test_no_pickle_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"a": _Code()}, "w.pth")
    np.save("a.npy", np.array([_Code()]), allow_pickle=True)
    np.savez("a.npz", flow=np.array([_Code()], dtype=object))
    for read, name in ((load_network, "w.pth"), (read_array, "a.npy"), (read_arrays, "a.npz")):
        with pytest.raises(DgcPoseError, match=name) as caught:
            read(Path(name))
        assert "weights_only" not in str(caught.value)
    assert not Path("executed").exists()


@pytest.mark.parametrize(
    ("value", "words"), [(np.nan, "not finite"), (np.inf, "not finite"), (1j, "not real")]
)
def test_weights_that_are_no_numbers_are_refused(value: complex, words: str, tmp_path: Path):
    save_weights(DGCNet(preset("dgcm-lite0")), tmp_path / "w.safetensors")
    from safetensors.torch import load_file

    state = load_file(tmp_path / "w.safetensors")
    key = sorted(state)[0]
    if isinstance(value, complex):
        state[key] = state[key].to(torch.complex64)
    else:
        state[key].view(-1)[0] = value
    save_file(state, tmp_path / "w.safetensors", metadata={"preset": "dgcm-lite0"})
    with pytest.raises(WeightsError, match=words) as caught:
        load_network(tmp_path / "w.safetensors")
    assert key in str(caught.value)


def test_a_packed_checkpoint_is_refused(tmp_path: Path) -> None:
    stream = io.BytesIO()
    torch.save({"a": torch.zeros(10)}, stream)
    with zipfile.ZipFile(stream) as old, zipfile.ZipFile(tmp_path / "w.pth", "w", 8) as new:
        for info in old.infolist():
            new.writestr(info.filename, old.read(info))
    with pytest.raises(WeightsError, match="packed"):
        load_network(tmp_path / "w.pth")


@pytest.mark.parametrize(
    "content", [b"PK\x03\x04" + b"0" * 60, b"\x93NUMPY\x01\x00\x46\x00{'descr': 5" + b" " * 80, b""]
)
def test_an_npy_that_is_none(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.npy is not an \.npy that can be read"):
        read_array(tmp_path / "a.npy")


def test_an_npy_that_claims_too_much_takes_no_memory(tmp_path: Path) -> None:
    header = io.BytesIO()
    about = {"descr": "<f8", "fortran_order": False, "shape": (2**40, 2**40)}
    np.lib.format.write_array_header_1_0(header, about)
    (tmp_path / "a.npy").write_bytes(header.getvalue() + b"0" * 80)
    with pytest.raises(InputError, match="cannot reshape"):
        read_array(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("flow.npy", header.getvalue())
    data = bytearray((tmp_path / "a.npz").read_bytes())
    place = data.rindex(b"PK\x01\x02") + 24  # the unpacked size in the archive's directory
    data[place : place + 4] = (ARRAY_BYTES + 1).to_bytes(4, "little")
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(InputError, match="too large"):
        read_arrays(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["results.csv", "run.json"])
@pytest.mark.parametrize("content", [b'"' + b"x" * 200_000, b"[" * 100_000, b"\0\n\0\n", b"\xff\n"])
def test_a_run_whose_files_are_odd_is_refused(name: str, content: bytes, tmp_path: Path) -> None:
    RunStore(tmp_path, PairScore, [], {})
    (tmp_path / name).write_bytes(content + b"\n")
    with pytest.raises(InputError, match=name):
        RunStore(tmp_path, PairScore, [], {}, resume=True)


@pytest.mark.parametrize("suffix", ["png", "tiff", "bmp", "gif", "ppm", "jp2", "jpg", "webp"])
def test_a_corrupt_image_prints_nothing(suffix: str, tmp_path: Path, capfd) -> None:
    path = tmp_path / f"a.{suffix}"
    pixels = np.random.default_rng(0).integers(0, 255, (40, 50, 3), np.uint8)
    PIL.Image.fromarray(pixels).save(path)
    whole = path.read_bytes()
    for share in (0.3, 0.6, 0.9):
        damaged = bytearray(whole[: int(len(whole) * share)])
        damaged[len(damaged) // 2] ^= 0xFF
        path.write_bytes(damaged)
        with pytest.raises(ImageError):
            load_image(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_odd_exif_data_prints_nothing(suffix: str, tmp_path: Path, capfd, recwarn) -> None:
    path = tmp_path / f"a.{suffix}"
    exif = b"Exif\0\0II*\0\x08\0\0\0\xff\xff" + b"\x0f\x01\x02\0\xff\xff\xff\xff" * 9
    PIL.Image.new("RGB", (40, 30)).save(path, exif=exif)
    assert load_image(path).size == (40, 30)
    guess_camera(path)
    assert capfd.readouterr() == ("", "") and not recwarn.list


def test_a_png_that_claims_a_huge_chunk_or_size_is_refused_unread(tmp_path: Path) -> None:
    for name, data in (
        ("chunk.png", png_claiming(4, 4, chunk=2**31 - 10)),
        ("size.png", png_claiming(20_000, 20_000)),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ImageError, match=name):
            load_image(tmp_path / name)
    with pytest.raises(ImageError, match=r"20000 x 20000, at most 210000000 pixels are read$"):
        load_image(tmp_path / "size.png")


def test_bad_photographs_among_good_ones_are_left_out_and_told(tmp_path: Path, caplog) -> None:
    paths = verdict_folder.write_photos(tmp_path / "photos", 60)
    good = [len(part.pixels) for part in load_photos(tmp_path / "photos", 8)]
    paths[0].write_bytes(png_claiming(60_000, 50_000))
    paths[1].write_bytes(paths[1].read_bytes()[:200])
    paths[2].unlink()
    os.mkfifo(paths[2])
    found = [len(part.pixels) for part in load_photos(tmp_path / "photos", 8)]
    assert sum(found) == sum(good) - 3
    assert "photographs are left out" in caplog.text


def test_a_large_image_that_memory_does_not_hold_is_one_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    PIL.Image.new("RGB", (40, 30)).save(tmp_path / "a.png")

    def decode(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(cv2, "imdecode", decode)
    with pytest.raises(ImageError, match=r"a\.png needs more memory than there is"):
        load_image(tmp_path / "a.png")


IMAGE = np.zeros((40, 50, 3), np.uint8)
CAMERA = np.array([[50.0, 0, 24.5], [0, 50, 19.5], [0, 0, 1]])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: estimate_relative_pose(IMAGE, IMAGE, CAMERA, matcher="sift"), "matcher"),
        (lambda: estimate_relative_pose(IMAGE, IMAGE, CAMERA, matcher=5), "matcher"),
        (
            lambda: estimate_relative_pose(
                IMAGE, IMAGE, CAMERA, matcher=load_matcher("sift"), options={"runs": 1}
            ),
            "options",
        ),
        (
            lambda: estimate_relative_pose(None, IMAGE, CAMERA, matcher=load_matcher("sift")),
            "image1",
        ),
        (lambda: estimate_relative_pose(IMAGE, IMAGE, "K", matcher=load_matcher("sift")), "K1"),
        (lambda: load_matcher(5), "name"),
        (lambda: load_matcher("sift", matching={}), "matching"),
        (lambda: load_matcher("sift", refinement="none"), "refinement"),
        (lambda: load_matcher("sift", device=0), "device"),
        (lambda: EstimationOptions(runs="5"), "runs"),
        (lambda: EstimationOptions(runs=2.5), "runs"),
        (lambda: EstimationOptions(seed=10**40), "seed"),
        (lambda: EstimationOptions(threshold_px="2"), "threshold_px"),
        (lambda: EstimationOptions(verdict=None), "verdict"),
        (lambda: EstimationOptions(refine="no"), "refine"),
    ],
)
def test_a_wrong_argument_is_named(call, name: str) -> None:
    with pytest.raises(InputError, match=rf"^{name}\b"):
        call()


def test_numpys_numbers_are_options() -> None:
    options = EstimationOptions(runs=np.int64(3), threshold_px=np.float32(2), seed=np.uint8(7))
    assert options.runs == 3 and isinstance(options.verdict, VerdictOptions)
