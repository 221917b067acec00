"""Disks that are full while whole commands run: the system's words, and nothing that is half."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
from batch_runs import view_folder
from fuzz.readers import make_batch, make_photographs
from multi_view import K_text
from world_scene import IMAGE, world_scene, write_colmap

FULL = """
import resource, sys
from dgc_pose.cli.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
main()
"""
EXPORT = ("export-colmap", "batch")
ESTIMATE = ("estimate", "one.png", "two.png", "--K", dense_scene.K_TEXT, "--weights", "sift")
MVS = ("export", "model", "--to", "openmvs", "--images", "pictures", "--out", "x.mvs")
BATCH = ("batch", "views", "--out", "out", "--pairs", "exhaustive", "--weights", "sift")
BATCH += ("--workers", "1", "--runs", "1", "--iterations", "100", "--K", K_text())


def full(folder: Path, size: int, *words: str) -> subprocess.CompletedProcess[str]:
    """A command whose files cannot become larger than `size` bytes."""
    command = [sys.executable, "-c", FULL, str(size), *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("size", "line", "words"),
    [
        (0, "x.db: File too large\n", (*EXPORT, "--database", "x.db")),
        (60_000, "x.db: File too large\n", (*EXPORT, "--database", "x.db")),
        (200_000, "x.db: File too large\n", (*EXPORT, "--database", "x.db")),
        (500, "x.ply: ", (*ESTIMATE, "--ply", "x.ply")),
        (3000, "out/matched.bin: ", BATCH),
        (100, "points.ply: 100 of ", ("export", "model", "--to", "nerfstudio", "--out", "x.n")),
        (900, "x.n: File too large\n", ("export", "model", "--to", "nerfstudio", "--out", "x.n")),
        (500, "x.tum: ", ("export", "model", "--to", "tum", "--out", "x.tum")),
        (90_000, "x.mvs: File too large\n", MVS),
    ],
)
def test_a_full_disk_is_one_line(
    tmp_path: Path, size: int, line: str, words: tuple[str, ...]
) -> None:
    """SQLite's and HDF5's errors once ended the process, and left files. A batch goes on."""
    (tmp_path / "batch").mkdir()
    make_batch(tmp_path / "batch")
    make_photographs(tmp_path / "batch")
    dense_scene.write_pictures(tmp_path)
    view_folder(tmp_path / "views", 2)
    scene = world_scene(count=20)
    write_colmap(scene, tmp_path / "model")
    (tmp_path / "pictures").mkdir()
    for name in scene.names:
        cv2.imwrite(str(tmp_path / "pictures" / name), np.zeros(IMAGE[::-1], np.uint8))
    ended = full(tmp_path, size, *words)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith(f"error: {line}") and ended.stderr.count("\n") == 1
    assert not list(tmp_path.glob("h/*")) and not list(tmp_path.glob("x.*"))
    if words == BATCH:
        again = full(tmp_path, 10**8, *words, "--resume")
        assert again.returncode == 0, again.stderr
        names = {"plan.json", "pairs.jsonl", "matches.h5", "summary.json"}
        assert set(os.listdir(tmp_path / "out")) == names
