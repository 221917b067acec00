"""`dgc-pose rig`: its text, exit codes and files, of a rig whose cameras are known."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
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


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With the pictures of three cameras in frames/."""
    monkeypatch.chdir(tmp_path)
    write_views(tmp_path / "frames", VIEWS)
    return tmp_path


def cameras(turned: str = "") -> dict[str, Location]:
    """turned: the name of one that is turned by two degrees."""
    known = {"covariance": COVARIANCE, "probability": 0.97, "camera": Camera(K, SIZE)}
    found = {}
    for name, view in zip(("view0", "view1", "view2"), VIEWS, strict=True):
        turn = Rotation.from_euler("x", 2.0 * (name == turned), degrees=True).as_matrix()
        found[name] = Location("located", "", (), turn @ view.R, view.centre, **known)
    return found


def model_of(located: dict[str, Location]) -> Model:
    """A model of the pictures in frames/."""
    poses = {f"{name}.png": location.cam_from_world for name, location in located.items()}
    return Model(Path("frames"), dict.fromkeys(poses, Camera(K, SIZE)), poses)


def estimated(monkeypatch: pytest.MonkeyPatch, rig: Rig | None = None) -> list[dict[str, Any]]:
    """Every estimate is this rig, by default of the cameras. Returns what it is asked for."""
    located, asked = cameras(), []
    model = model_of(located)
    metric, warnings = {"unit": "m", "scale_relative_std": 0.002}, ("two have one pose",)

    def estimate(frames: Path, out: Path, walk: object, **options: Any) -> Rig:
        asked.append({"walk": walk, **options})
        out.mkdir(exist_ok=True)
        return rig or Rig({**located, "west": NOWHERE}, model, metric, warnings)

    monkeypatch.setattr("dgc_pose.rigs.rig.estimate_rig", estimate)
    return asked


def test_the_text_and_the_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = estimated(monkeypatch)
    words = ("rig", "frames", "--out", "out", "--walk", "photos", "--walk-K", "1,1,1,1")
    result = run(*words, "--K", "view0=500,500,320,240", "--K", "view1=auto", "--marker", 0.2)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[1].startswith("view1: centre") and lines[1].endswith(
        "+- 0.005 m, R +- 0.14 deg, f = 225.8 px, probability 97 %"
    )
    assert lines[3] == f"west: not placed: {NOWHERE.reason}"
    assert lines[4:7] == ["warning: two have one pose", "unit: m", "scale relative std: 0.002"]
    data = json.loads((folder / "out" / "rig.json").read_text())
    assert {*data["files"]} | {"model.html"} == {path.name for path in (folder / "out").iterdir()}
    assert data["not_placed"] == {"west": NOWHERE.reason} and data["unit"] == "m"
    assert data["warnings"] == ["two have one pose"]
    assert {str(Path("out") / file) for file in data["files"]} <= {*lines}
    assert asked[0]["K"] == {"view0": "500,500,320,240", "view1": "auto"}
    assert (asked[0]["walk"], asked[0]["walk_K"]) == ("photos", "1,1,1,1")
    assert asked[0]["reconstruction"].marker == 0.2


def test_a_bad_picture_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = Location("bad_input", "frames/east.jpg is empty", ())
    estimated(monkeypatch, Rig({"view0": NOWHERE, "east": bad}))
    result = run("rig", "frames", "--out", "out")
    assert result.exit_code == 3
    assert result.stderr == "bad image east: frames/east.jpg is empty\n"
    data = json.loads((folder / "out" / "rig.json").read_text())
    assert data["not_placed"]["east"] == bad.reason
    estimated(monkeypatch, Rig({"west": replace(bad, reason="is cut"), "east": bad}))
    assert_all_bad(run("rig", "frames", "--out", "none"), "west: is cut", bad.reason)
    assert not (folder / "none" / "rig.json").exists()


def test_nothing_placed_is_exit_code_3(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimated(monkeypatch, Rig({"view0": NOWHERE}))
    result = run("rig", "frames", "--out", "out")
    assert result.exit_code == 3
    assert result.stdout == f"view0: not placed: {NOWHERE.reason}\nout/rig.json\n"
    assert [path.name for path in (folder / "out").iterdir()] == ["rig.json"]
    data = json.loads((folder / "out" / "rig.json").read_text())
    assert data["not_placed"] == {"view0": NOWHERE.reason} and not data["cameras"]


def test_a_rig_that_is_not_in_metres_is_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Up to scale, with the error and the way to go on."""
    located = cameras()
    why = InputError(ArgumentName("scale"), "names west, which has no place")
    estimated(monkeypatch, Rig(located | {"west": NOWHERE}, model_of(located), not_in_metres=why))
    result = run("rig", "frames", "--out", "out", "--scale", "view0,west,2")
    assert result.exit_code == 2
    assert result.stderr == (
        "error: out/rig.json is up to scale, and --resume with another scale keeps the matches: "
        "--scale names west, which has no place\n"
    )
    data = json.loads((folder / "out" / "rig.json").read_text())
    assert {*data["cameras"]} == {*located} and data["unit"] == ""
    assert data["warnings"] == ["not in metres: scale names west, which has no place"]
    assert (folder / "out" / "model.html").is_file()


def test_cameras_are_named_as_their_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With blanks, dots, umlauts and =, by --K and in each file."""
    renamed = {"Kamera.2 süd": "view0", 'f=8 "links"': "view1", "door.v2": "view2"}
    found = cameras()
    located = {name: found[view] for name, view in renamed.items()}
    for name, view in renamed.items():
        (folder / "frames" / f"{view}.png").rename(folder / "frames" / f"{name}.png")
    asked = estimated(monkeypatch, Rig(located, model_of(located)))
    words = ("rig", "frames", "--out", "out")
    texts = [f"{name}=500,500,320,240" for name in renamed]
    result = run(*words, *(word for text in texts for word in ("--K", text)))
    assert result.exit_code == 0, result.output
    assert asked[0]["K"] == dict.fromkeys(renamed, "500,500,320,240")
    for file in ("calibration.toml", "camera_array.toml", "rig_config.json", "rig.json"):
        read = read_calibration(str(folder / "out" / file))
        assert [*read.parts] == [*renamed]
        for name, location in located.items():
            R = read.poses[name][:, :3] @ read.poses["door.v2"][:, :3].T
            np.testing.assert_allclose(R, location.R @ located["door.v2"].R.T, atol=1e-9)


def lines_of_changes(folder: Path, before: dict[str, Location], file: str) -> list[str]:
    """The lines of the command about three cameras since the rig `before`, by one of its files."""
    (folder / "before").mkdir()
    write_rig(folder / "before", before, {"unit": "m"})
    result = run("rig", "frames", "--out", "out", "--start", f"before/{file}")
    assert result.exit_code == 0, result.output
    lines: list[str] = result.stdout.splitlines()[-3:]
    return lines


def test_start_tells_that_two_cameras_changed_places(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimated(monkeypatch)
    found = cameras()
    before = found | {"view0": found["view2"], "view2": found["view0"]}
    first, second, third = lines_of_changes(folder, before, "rig.json")
    assert first.startswith("view0 is where view2 was, to 0.000 +- 0.143 deg")
    assert second.startswith("view1 has not moved")
    assert third.startswith("view2 is where view0 was, to 0.000 +- 0.143 deg")
    assert third.endswith("the two, or their pictures, changed places")


def test_start_tells_which_camera_moved(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimated(monkeypatch)
    first, second, third = lines_of_changes(folder, cameras("view2"), "calibration.toml")
    assert first.startswith("view0 has not moved: by 0.000 +- 0.143 deg")
    assert second.startswith("view1 has not moved")
    assert third.startswith("view2 moved: by 2.000 +- 0.143 deg")
    assert third.endswith("m, focal length +0.00 %")
