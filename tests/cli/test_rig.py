"""`dgc-pose rig`: its text, exit codes and files, of a rig whose cameras are known."""

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from command_line import assert_all_bad, run
from scipy.spatial.transform import Rotation
from worlds import SIZE, K, render_views, write_views

from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.localization.location import Location
from dgc_pose.model import Model
from dgc_pose.rigs.files import write_rig
from dgc_pose.rigs.rig import Rig

VIEWS = render_views(3)
COVARIANCE = np.diag([1e-3] * 3 + [2e-3] * 3) ** 2
NOWHERE = Location("nowhere", "none of 4 database images has a pose", ())


def cameras(turned: str = "") -> dict[str, Location]:
    """The cameras of frames/. turned: the name of one that is turned by two degrees."""
    known = {"covariance": COVARIANCE, "probability": 0.97, "camera": Camera(K, SIZE)}
    found = {}
    for name, view in zip(("view0", "view1", "view2"), VIEWS, strict=True):
        turn = Rotation.from_euler("x", 2.0 * (name == turned), degrees=True).as_matrix()
        found[name] = Location("located", "", (), turn @ view.R, view.centre, **known)
    return found


def rig_of(located: dict[str, Location], *others: Any, **more: Any) -> Rig:
    """A rig with a model of the located ones, and cameras `west` that have no place."""
    poses = {f"{name}.png": location.cam_from_world for name, location in located.items()}
    model = Model(Path("frames"), dict.fromkeys(poses, Camera(K, SIZE)), poses)
    return Rig({**located, "west": NOWHERE}, model, *others, **more)


@pytest.fixture
def estimated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Runs `rig frames --out out`, whose estimate is a rig, in a folder with the pictures of three
    cameras in frames/. Returns the result, what rig.json holds, and what the estimate is asked."""
    monkeypatch.chdir(tmp_path)
    write_views(tmp_path / "frames", VIEWS)

    def use(rig: Rig, *words: object) -> tuple[Result, dict[str, Any], dict[str, Any]]:
        asked: dict[str, Any] = {}

        def estimate(frames: Path, out: Path, walk: object, **options: Any) -> Rig:
            asked.update(options, walk=walk)
            out.mkdir(exist_ok=True)
            return rig

        monkeypatch.setattr("dgc_pose.rigs.rig.estimate_rig", estimate)
        result = run("rig", "frames", "--out", "out", *words)
        file = tmp_path / "out/rig.json"
        return result, json.loads(file.read_text()) if file.is_file() else {}, asked

    return use


def test_the_text_and_the_files(estimated: Callable[..., Any]) -> None:
    rig = rig_of(cameras(), {"unit": "m", "scale_relative_std": 0.002}, ("two have one pose",))
    words = ("--walk", "photos", "--walk-K", "1,1,1,1", "--marker", 0.2)
    K_words = ("--K", "view0=500,500,320,240", "--K", "view1=auto")
    result, data, asked = estimated(rig, *words, *K_words)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[1].startswith("view1: centre") and lines[1].endswith(
        "+- 0.005 m, R +- 0.14 deg, f = 225.8 px, probability 97 %"
    )
    assert lines[3] == f"west: not placed: {NOWHERE.reason}"
    assert lines[4:7] == ["warning: two have one pose", "unit: m", "scale relative std: 0.002"]
    assert {*data["files"]} | {"model.html"} == {*os.listdir("out")}
    assert data["not_placed"] == {"west": NOWHERE.reason} and data["unit"] == "m"
    assert data["warnings"] == ["two have one pose"]
    assert {f"out/{file}" for file in data["files"]} <= {*lines}
    assert asked["K"] == {"view0": "500,500,320,240", "view1": "auto"}
    assert (asked["walk"], asked["walk_K"]) == ("photos", "1,1,1,1")
    assert asked["reconstruction"].marker == 0.2


def test_nothing_placed_is_exit_code_3_and_a_bad_picture_is_named(
    estimated: Callable[..., Any],
) -> None:
    bad = Location("bad_input", "frames/east.jpg is empty", ())
    result, *_ = estimated(Rig({"west": replace(bad, reason="is cut"), "east": bad}))
    assert_all_bad(result, "west: is cut", bad.reason)
    assert not Path("out/rig.json").exists()
    result, data, _ = estimated(Rig({"view0": NOWHERE, "east": bad}))
    assert result.exit_code == 3
    assert result.stderr == "bad image east: frames/east.jpg is empty\n"
    assert result.stdout.startswith(f"view0: not placed: {NOWHERE.reason}\n")
    assert result.stdout.endswith("\nout/rig.json\n") and os.listdir("out") == ["rig.json"]
    assert data["not_placed"] == {"view0": NOWHERE.reason, "east": bad.reason}
    assert not data["cameras"]


def test_a_rig_that_is_not_in_metres_is_there(estimated: Callable[..., Any]) -> None:
    """Up to scale, with the error and the way to go on."""
    why = InputError(ArgumentName("scale"), "names west, which has no place")
    rig = rig_of(cameras(), not_in_metres=why)
    result, data, _ = estimated(rig, "--scale", "view0,west,2")
    assert result.exit_code == 2
    assert result.stderr == (
        "error: out/rig.json is up to scale, and --resume with another scale keeps the matches: "
        "--scale names west, which has no place\n"
    )
    assert {*data["cameras"]} == {*cameras()} and data["unit"] == ""
    assert data["warnings"] == ["not in metres: scale names west, which has no place"]
    assert Path("out/model.html").is_file()


def test_cameras_are_named_as_their_files(estimated: Callable[..., Any]) -> None:
    """With blanks, dots, umlauts and =, by --K and in each file."""
    renamed = {"Kamera.2 süd": "view0", 'f=8 "links"': "view1", "door.v2": "view2"}
    found = cameras()
    located = {name: found[view] for name, view in renamed.items()}
    words = []
    for name, view in renamed.items():
        Path(f"frames/{view}.png").rename(f"frames/{name}.png")
        words += ["--K", f"{name}=500,500,320,240"]
    result, _, asked = estimated(rig_of(located), *words)
    assert result.exit_code == 0, result.output
    assert asked["K"] == dict.fromkeys(renamed, "500,500,320,240")
    for file in ("calibration.toml", "camera_array.toml", "rig_config.json", "rig.json"):
        read = read_calibration(f"out/{file}")
        assert [*read.parts] == [*renamed]
        for name, location in located.items():
            R = read.poses[name][:, :3] @ read.poses["door.v2"][:, :3].T
            np.testing.assert_allclose(R, location.R @ located["door.v2"].R.T, atol=1e-9)


FOUND = cameras()


@pytest.mark.parametrize(
    ("before", "file", "lines"),
    [
        (
            FOUND | {"view0": FOUND["view2"], "view2": FOUND["view0"]},
            "rig.json",
            [
                r"view0 is where view2 was, to 0\.000 \+- 0\.143 deg",
                "view1 has not moved",
                r"view2 is where view0 was, to 0\.000 \+- 0\.143 deg.*"
                "the two, or their pictures, changed places$",
            ],
        ),
        (
            cameras("view2"),
            "calibration.toml",
            [
                r"view0 has not moved: by 0\.000 \+- 0\.143 deg",
                "view1 has not moved",
                r"view2 moved: by 2\.000 \+- 0\.143 deg.*m, focal length \+0\.00 %$",
            ],
        ),
    ],
    ids=["exchanged", "turned"],
)
def test_start_tells_which_cameras_moved_or_changed_places(
    estimated: Callable[..., Any], before: dict[str, Location], file: str, lines: list[str]
) -> None:
    Path("before").mkdir()
    write_rig(Path("before"), before, {"unit": "m"})
    result, *_ = estimated(rig_of(FOUND, {"unit": "m"}), "--start", f"before/{file}")
    assert result.exit_code == 0, result.output
    for line, expected in zip(result.stdout.splitlines()[-3:], lines, strict=True):
        assert re.match(expected, line), line
