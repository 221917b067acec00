"""Unusable input of each command: one line, exit code 2, and nothing written. Options of any value
are in tests/fuzz/test_commands.py."""

import shlex
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
from command_line import assert_refused, contents, run
from given_world import given_world, write_hloc
from worlds import K_text, known_model, render_views, write_views

from dgc_pose.geometry.rotation import quaternion_wxyz

VIEWS = render_views(3)
K = K_text()
OUT = f"--K {K} --out o"
LOCATE = "locate frames/view2.png --images images --add m --json o.json --model"
JUDGE = "judge h --K 900,905,500,390 --out o.db --csv p.csv --json p.json"
MOVED = "--weights sift"
LIST = "bench-pairs pairs.txt --runs 1 --methods sift"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """frames/ has three views, images/ and poses.csv the first two as a model; h/ is of hloc."""
    folder = tmp_path_factory.mktemp("refused")
    dense_scene.write_pair_list(folder)
    write_views(folder / "frames", VIEWS)
    write_views(folder / "walk/part", VIEWS[:2])
    write_views(folder / "one", VIEWS[:1])
    model = known_model(folder / "images", VIEWS[:2])
    lines = ["name,qw,qx,qy,qz,tx,ty,tz,fx,fy,cx,cy"]
    for name, pose in model.poses.items():
        values = [*quaternion_wxyz(pose[:, :3]), *pose[:, 3]]
        lines.append(",".join([name, *map(str, values), K]))
    write_hloc(given_world(count=4), folder / "h", sizes=False)
    (folder / "empty").mkdir()
    for name, text in {
        "poses.csv": "\n".join(lines),
        "list.toml": "[metadata]\n",
        "text.db": "no database\n" * 99,
    }.items():
        (folder / name).write_text(text)
    (folder / "sizes").mkdir()
    for name, pixels in {
        "black.png": np.zeros((240, 320, 3), np.uint8),
        "sizes/a.png": VIEWS[0].pixels,
        "sizes/b.png": VIEWS[0].pixels[:150],
    }.items():
        cv2.imwrite(str(folder / name), pixels)
    return folder


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("estimte", ["error: No such command 'estimte'."]),
        ("estimate a.png", ["IMG2"]),
        ("estimate a.png b.png --json no/x.json", ["--json: no/x.json: No such file"]),
        ("estimate auto b.png", ["error: auto cannot be read"]),
        ("estimate no.png b.png --mask1 no.png", ["error: no.png cannot be read"]),
        (
            "estimate frames/view0.png frames/view1.png --mask2 nowhere.png --json o.json",
            ["nowhere.png cannot be read: No such"],
        ),
        (f"batch empty {OUT}", ["empty", "no image, and a pair needs two"]),
        (f"reconstruct one {OUT}", ["one", "one image, and a pair needs two"]),
        (f"reconstruct walk/part {OUT}", ["walk/part", "2 images, and a model needs 3"]),
        (
            f"batch sizes --weights sift {OUT}",
            ["--K is a single K, and the images have several sizes (240x150 and 240x180)"],
        ),
        ("judge none.db", ["none.db"]),
        ("judge text.db", ["cannot be read as a COLMAP database"]),
        ("judge empty", ["holds neither hloc's .h5 nor an .npz"]),
        ("judge h --K nothing", ["--K: 'nothing' is neither"]),
        (f"{JUDGE} --resume", ["--resume needs --batch"]),
        (f"{JUDGE} --images nowhere", ["none of the 4 images of h"]),
        (f"judge h --K {K} --images empty", ["--images", "none of the 4 images of h"]),
        (f"{LOCATE} poses.csv --K 500,500,320,240", ["K"]),
        (f"{LOCATE} poses.csv --K 1,2", ["--K: '1,2' is neither auto"]),
        (f"{LOCATE} poses.csv --K auto --weights sift", ["cannot choose pairs"]),
        (f"{LOCATE} none", ["--model"]),
        (f"{LOCATE} poses.csv --masks none", ["--masks"]),
        (
            f"locate frames/view1.png --model poses.csv --images images --K {K} --add m",
            ["--add", "has an image view1.png already"],
        ),
        (
            "locate black.png black.png --model poses.csv --images images --plot o.png",
            ["--plot", "draws a single query, not 2"],
        ),
        (f"moved frames/view0.png empty --K {K} {MOVED}", ["empty: no image is in this folder"]),
        (f"moved frames/view0.png missing.png --K {K} {MOVED}", ["missing.png"]),
        (f"moved frames/view0.png one --K 600 {MOVED}", ["--K: '600' is neither"]),
        (f"moved black.png one --K {K}", ["black.png: ", "grey levels differ by 0.0"]),
        ("moved a.png b.png --json ./no/x", ["--json: ./no/x: No such file"]),
        ("rig none --out o", ["error: FRAMES none: no such folder"]),
        ("rig frames --out o --start /dev/null", ["--start: /dev/null is not a regular file"]),
        ("rig one --out o", ["1 cameras found, and a rig has two"]),
        ("rig frames --out o --model one", ["--model needs --images, and no --walk"]),
        ("rig frames --out o --start list.toml", ["list.toml"]),
        ("rig frames --out o --K list.toml", ["list.toml"]),
        ("rig frames --out o --K east=1,1,1,1", ["--K is of east, and the cameras are view0, v"]),
        ("rig frames --out o --K view0=1,2", ["K of view0"]),
        ("rig frames --out o --scale view0,east,2", ["--scale must be two of the 3 images (such"]),
        ("rig frames --out o --gps --marker 0.2", ["--gps and --marker both set the scale"]),
        ("rig frames --out o --walk missing", ["--walk: missing is not a folder"]),
        ("rig frames --out o --walk walk --walk-K 1,2", ["K: '1,2' is neither auto"]),
        ("bench-pairs", ["LIST"]),
        (f"{LIST} --matches raft=nowhere", ["nowhere/one.png_two"]),
        (f"{LIST} --resume", ["--out"]),
        (f"{LIST} --K auto --K-scale 2", ["cannot be scaled"]),
    ],
)
def test_unusable_input_is_one_line_and_writes_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, command: str, words: list[str]
) -> None:
    monkeypatch.chdir(folder)
    before = contents(folder)
    assert_refused(run(*shlex.split(command)), *words)
    assert contents(folder) == before
