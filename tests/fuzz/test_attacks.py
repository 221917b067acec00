"""What a stranger's batches, databases, lists and requests may not do, each once possible."""

from __future__ import annotations

import json
import os
import sqlite3
import struct
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import dense_scene
import h5py
import numpy as np
import pycolmap
import pytest
from click.testing import CliRunner, Result
from fuzz.bad_values import png_claiming
from fuzz.readers import make_batch
from fuzz.test_commands import hashes

from dgc_pose.batch.pair_choice import parse_pair_choice
from dgc_pose.batch.plan import read_plan
from dgc_pose.batch.rows import read_rows
from dgc_pose.batch.run import read_batch
from dgc_pose.batch.store import PartStore
from dgc_pose.benchmarks.posed_views import PosedViews
from dgc_pose.benchmarks.probability.plan import read_plan as read_sources
from dgc_pose.cameras.camera import Camera, guess_camera
from dgc_pose.cameras.colmap_files import read_database, read_model_cameras
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.cli.main import main
from dgc_pose.errors import ImageError, InputError
from dgc_pose.files.outputs import only_writer, replaced_folder
from dgc_pose.serve.cameras import command


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def assert_refused(result: Result, *words: str) -> None:
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr


@pytest.fixture
def batch(tmp_path: Path) -> Path:
    """A finished batch of three small pictures that lie in its own folder."""
    folder = tmp_path / "batch"
    folder.mkdir()
    make_batch(folder)
    return folder


def test_a_batch_removes_its_own_parts_alone(batch: Path) -> None:
    parts = batch / "parts"
    parts.mkdir()
    for name in ("drawing.h5", "letter.txt", "000000001.h5"):
        (parts / name).write_text("half")
    (batch / "summary.json").unlink()
    store = PartStore(batch, read_plan(batch))
    assert store.left == [0, 1]
    assert sorted(os.listdir(parts)) == ["drawing.h5", "letter.txt"]
    (parts / ".000000001.h5.partial").mkdir()
    store.close()
    assert sorted(os.listdir(parts)) == ["drawing.h5", "letter.txt"]


def test_a_second_batch_in_one_folder_is_refused(tmp_path: Path) -> None:
    from batch_runs import run_sift, view_folder

    view_folder(tmp_path / "views", 2)
    (tmp_path / "out").mkdir()
    with only_writer(tmp_path / "out"), pytest.raises(InputError, match="another run"):
        run_sift(tmp_path / "views", tmp_path / "out")
    with pytest.raises(InputError, match="a folder needs --pairs"):
        run_sift(tmp_path / "views", tmp_path / "new" / "deep", pairs=None)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("present", ["sparse/0/cameras.bin", "picture.png", "points.ply"])
@pytest.mark.parametrize("resume", [(), ("--resume",)], ids=["", "resume"])
def test_reconstruct_keeps_what_is_not_its_own(
    tmp_path: Path, present: str, resume: tuple[str, ...]
) -> None:
    path = tmp_path / present
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("of the user")
    result = run("reconstruct", tmp_path, "--out", tmp_path, "--K", "9,9,4,3", *resume)
    assert_refused(result, "is there already")
    assert path.read_text() == "of the user"


def test_a_model_folder_with_other_files_is_kept(batch: Path) -> None:
    """Also beside a batch of ours."""
    (batch / "batch").mkdir()
    make_batch(batch / "batch")
    (batch / "sparse").mkdir()
    (batch / "sparse/letter.txt").write_text("dear friend")
    result = run("reconstruct", batch, "--out", batch, "--K", "9,9,4,3", "--resume")
    assert_refused(result, "sparse: holds other files")


@pytest.mark.parametrize(
    "arguments",
    [
        ("--database", "matches.h5"),
        ("--database", "plan.json"),
        ("--database", "a.png"),
        ("--hloc", "."),
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)], ids=["", "overwrite"])
def test_export_never_replaces_its_batch(
    batch: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple, overwrite: tuple
) -> None:
    monkeypatch.chdir(batch)
    Path("a.png").write_bytes(b"\x89PNG")
    before = hashes(batch)
    words = ("export-colmap", ".", "--sharing", "cells", *arguments, *overwrite)
    assert_refused(run(*words))
    assert hashes(batch) == before


def test_copies_for_a_benchmark_never_replace_the_images(tmp_path: Path) -> None:
    views = PosedViews(tmp_path, {"a.png": Camera(np.eye(3))}, {"a.png": np.eye(4)[:3]})
    (tmp_path / "a.png").write_bytes(b"image")
    with pytest.raises(InputError, match="would be lost"):
        views.resized(0.5, tmp_path)


def _link(file: h5py.File, other: Path) -> None:
    file["a.png/b.png"] = h5py.ExternalLink(str(other), "/")


def _linked_points(file: h5py.File, other: Path) -> None:
    file["a.png/b.png/keypoints0"] = h5py.ExternalLink(str(other), "/x")


def _raw_file(file: h5py.File, other: Path) -> None:
    raw = [(str(other), 0, 64)]
    file.create_dataset("a.png/b.png/keypoints0", (8, 2), "f4", external=raw)


def _texts(file: h5py.File, other: Path) -> None:
    file["a.png/b.png/keypoints0"] = np.array([[b"x", b"y"]] * 8)


def _not_finite(file: h5py.File, other: Path) -> None:
    file["a.png/b.png/keypoints0"] = np.full((8, 2), np.nan, np.float32)


def _huge(file: h5py.File, other: Path) -> None:
    file.create_dataset("a.png/b.png/keypoints0", (2**40, 2), "f4", chunks=(64, 2))


@pytest.mark.parametrize("damage", [_link, _linked_points, _raw_file, _texts, _not_finite, _huge])
def test_a_file_of_matches_leads_nowhere(batch: Path, damage) -> None:
    """HDF5 could follow links to any file: here to a pipe, which would never answer."""
    os.mkfifo(batch / "pipe")
    with h5py.File(batch / "matches.h5", "r+") as file:
        del file["a.png/b.png" if damage is _link else "a.png/b.png/keypoints0"]
        damage(file, batch / "pipe")
    with pytest.raises(InputError, match=r"matches\.h5"):
        list(read_batch(batch).matches())


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("R", [1, 2, 3]),
        ("R", [None] * 9),
        ("t", [1e999, 0, 0]),
        ("num_matches", "many"),
        ("name1", 3),
        ("success", 1),
        ("warnings", [1]),
        ("status", None),
    ],
)
def test_a_row_of_other_types_is_refused(batch: Path, field: str, value: object) -> None:
    path = batch / "pairs.jsonl"
    row = json.loads(path.read_text().splitlines()[0])
    path.write_text(json.dumps(row | {field: value}) + "\n")
    with pytest.raises(InputError, match=rf"pairs\.jsonl:1: {field}"):
        list(read_rows(path))


@pytest.mark.parametrize(
    "change",
    [
        {"pairs": [[0, 3]]},
        {"pairs": [[-1, 0]]},
        {"settings": {"format": "../x"}},
        {"settings": []},
        {"images": 5},
    ],
    ids=str,
)
def test_a_plan_that_does_not_hold_together_is_refused(batch: Path, change: dict) -> None:
    data = json.loads((batch / "plan.json").read_text())
    (batch / "plan.json").write_text(json.dumps(data | change))
    with pytest.raises(InputError, match=r"plan\.json: not the plan"):
        read_plan(batch)


def _camera_bin(folder: Path) -> Path:
    camera = struct.pack("<QIiQQ4d", 1, 1, 1, 10, 8, 9, 9, 5, 4)
    (folder / "cameras.bin").write_bytes(camera)
    return folder / "cameras.bin"


def test_a_signalling_nan_in_a_camera_prints_nothing(tmp_path: Path, recwarn) -> None:
    path = _camera_bin(tmp_path)
    path.write_bytes(path.read_bytes()[:-16] + b"\xc2\xe5\xf1\x7fd\xf5'H)\xc1\xba:\xecE\xf0\x7f")
    with pytest.raises(InputError):
        read_model_cameras(path)
    assert not recwarn.list


IMAGE = struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0"


def test_the_images_of_a_model_are_read_as_colmap_writes_them(tmp_path: Path) -> None:
    points = struct.pack("<QddQddQ", 2, 1, 2, 3, 1, 2, 3)
    (tmp_path / "images.bin").write_bytes(IMAGE + points)
    assert read_model_cameras(_camera_bin(tmp_path))[1] == {"a.png": 1}
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 10 8 9 9 5 4\n")
    (tmp_path / "images.txt").write_text("# c\n\n1 1 0 0 0 0 0 0 1 a b.png\n1 2 -1\n")
    assert read_model_cameras(tmp_path / "cameras.txt")[1] == {"a b.png": 1}


@pytest.mark.parametrize(
    "content",
    [
        IMAGE[:-1],
        IMAGE[:-4],
        IMAGE,
        IMAGE + struct.pack("<Q", 2**60),
        IMAGE + struct.pack("<Q", 3) + b"1",
        b"",
        struct.pack("<Q", 2**62),
    ],
)
def test_the_images_of_a_model_that_are_cut_short_come_to_an_end(
    tmp_path: Path, content: bytes
) -> None:
    """pycolmap's own reader reads a name without an end for ever."""
    (tmp_path / "images.bin").write_bytes(content)
    with pytest.raises(InputError, match=r"images\.bin is not COLMAP's images"):
        read_model_cameras(_camera_bin(tmp_path))


def test_a_guessed_camera_decodes_no_image_that_is_too_large(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png_claiming(60_000, 50_000))
    with pytest.raises(ImageError, match="too large: 60000 x 50000"):
        guess_camera(tmp_path / "a.png")


def test_a_translation_too_long_to_be_scored_is_refused(tmp_path: Path, recwarn) -> None:
    dense_scene.write_pair_list(tmp_path, pairs=1)
    words = (tmp_path / "pairs.txt").read_text().split()
    words[-5] = "1e300"  # the last of t
    (tmp_path / "pairs.txt").write_text(" ".join(words) + "\n")
    with pytest.raises(InputError, match="no translation"):
        read_pairs(tmp_path / "pairs.txt")
    assert not recwarn.list


def test_a_batch_without_weights_leaves_nothing(tmp_path: Path) -> None:
    from multi_view import K_text, render_views, write_views

    write_views(tmp_path / "views", render_views(2))
    words = ("batch", tmp_path / "views", "--out", tmp_path / "out", "--pairs", "exhaustive")
    for weights in (tmp_path / "views/view0.png", "/proc/kmsg"):
        result = run(*words, "--K", K_text(), "--workers", 1, "--weights", weights)
        assert_refused(result, str(weights))
        assert os.listdir(tmp_path) == ["views"]


def test_a_collection_without_its_data_leaves_nothing(tmp_path: Path) -> None:
    words = ("fit-probability", "--data", tmp_path / "no", "--out", tmp_path / "out")
    assert_refused(run(*words, "--methods", "sift"), "no such data")
    assert os.listdir(tmp_path) == []


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n"


@pytest.mark.parametrize(
    "statement",
    [
        f"CREATE VIEW matches AS {ENDLESS}",
        "ALTER TABLE images ADD COLUMN big AS (zeroblob(1000000000))",
        "CREATE TRIGGER t AFTER INSERT ON cameras BEGIN DELETE FROM cameras; END",
    ],
)
def test_a_database_that_computes_is_refused(tmp_path: Path, statement: str) -> None:
    path = tmp_path / "a.db"
    with pycolmap.Database.open(path):
        pass
    with closing(sqlite3.connect(path)) as database:
        if "VIEW" in statement:
            database.execute("DROP TABLE matches")
        database.execute(statement)
        database.commit()
    with pytest.raises(InputError, match=r"a\.db is not a COLMAP database .*comput"):
        read_database(path)


@pytest.mark.parametrize("text", ["auto:" + "9" * 5000, "sequential:" + "1" * 4301])
def test_a_number_of_thousands_of_digits_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--pairs must be"):
        parse_pair_choice(text)


@pytest.mark.parametrize("name", ["../x", "/tmp/x", "a/b", "..", "", "a\0b", 5])
def test_a_plan_names_no_files_elsewhere(tmp_path: Path, name: object) -> None:
    plan = [{"name": name, "part": "fit", "kind": "list", "path": "a"}]
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    with pytest.raises(InputError, match=r"plan\.json: not a plan \(name must be"):
        read_sources(tmp_path / "plan.json")


def test_a_name_in_the_pages_command_is_no_option() -> None:
    assert "estimate ./--json=x b.png" in command(("--json=x", "b.png"), [], [])


HANDLERS = """
import signal
handler = lambda *_: None
signal.signal(signal.SIGTERM, handler)
from dgc_pose.system.colmap_library import pycolmap
assert signal.getsignal(signal.SIGTERM) is handler
import os, time
os.kill(os.getpid(), signal.SIGTERM)
time.sleep(0.01)
print(pycolmap.__name__, "goes on")
"""


def test_pycolmap_does_not_take_over_sigterm() -> None:
    """Its import alone made SIGTERM print a stack trace and end the process at once."""
    found = subprocess.run([sys.executable, "-c", HANDLERS], capture_output=True, text=True)
    assert (found.returncode, found.stdout, found.stderr) == (0, "pycolmap goes on\n", "")


def test_onnx_runtime_reports_nothing(tmp_path: Path) -> None:
    """Left to itself its telemetry starts a thread and keeps a file."""
    code = "import os\nfrom dgc_pose.runtime.session import Session\nimport time\n"
    code += "time.sleep(1)\nprint(os.environ['ORT_DISABLE_TELEMETRY'])"
    environment = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    environment |= {"TMPDIR": str(tmp_path), "OMP_NUM_THREADS": "1"}
    found = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True)
    assert found.stdout.startswith(b"1\n"), found.stderr
    assert os.listdir(tmp_path) == []


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    for content in ("old", "new"):
        with replaced_folder(path) as folder:
            (folder / "file").write_text(content)
    assert (path / "file").read_text() == "new"
    with pytest.raises(ZeroDivisionError), replaced_folder(path) as folder:
        (folder / "file").write_text("half")
        raise ZeroDivisionError
    assert (path / "file").read_text() == "new"
    assert os.listdir(tmp_path) == ["sparse"]
