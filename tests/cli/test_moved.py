"""`dgc-pose moved` on warped pictures, with SIFT."""

import json

import cv2
import dense_scene
import numpy as np
import pytest
from bad_pictures import BAD_PICTURES, write_bad_pictures
from command_line import assert_all_bad, assert_refused, run


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """reference.png; still.png, darker; later/turned.png, turned by 2 degrees; black.png."""
    monkeypatch.chdir(tmp_path)
    picture = dense_scene.pictures()[0]
    R = cv2.Rodrigues(np.radians([0.0, 2.0, 0.0]))[0]
    turn = dense_scene.K @ R @ np.linalg.inv(dense_scene.K)
    turned = cv2.warpPerspective(picture, turn, dense_scene.SIZE, borderMode=cv2.BORDER_REFLECT)
    (tmp_path / "later").mkdir()
    cv2.imwrite("reference.png", picture)
    cv2.imwrite("still.png", (0.7 * picture).astype(np.uint8))
    cv2.imwrite("later/turned.png", turned)
    cv2.imwrite("black.png", 0 * picture)
    return tmp_path


def moved(*now):
    return run("moved", "reference.png", *now, "--K", dense_scene.K_TEXT, "--weights", "sift")


def test_the_table_and_the_exit_code_have_the_verdicts(folder):
    result = moved("still.png")
    assert result.exit_code == 0, result.output
    assert "none has moved" in result.stdout and "still.png    still  0.0" in result.stdout
    result = moved("still.png", "black.png")
    assert result.exit_code == 3 and "only 0 matches" in result.stdout
    result = moved("black.png", "still.png", "later", "--json", "motions.json")
    assert result.exit_code == 1
    assert result.stdout.endswith("the first that has moved: later/turned.png\n")
    data = json.loads((folder / "motions.json").read_text())
    verdicts = {name: motion["verdict"] for name, motion in data.items()}
    expected = {"black.png": "cannot say", "still.png": "still", "later/turned.png": "moved"}
    assert verdicts == expected
    turned = data["later/turned.png"]
    assert abs(turned["angle_deg"] - 2) < turned["angle_error_90_deg"] < 1
    on_stdout = json.loads(moved("still.png", "--json", "-").stdout)
    assert on_stdout["still.png"]["verdict"] == "still"


def test_a_video_is_taken_as_its_frames(folder):
    writer = cv2.VideoWriter("day.avi", cv2.VideoWriter_fourcc(*"MJPG"), 5, dense_scene.SIZE)
    for _ in range(4):
        writer.write(cv2.imread("still.png"))
    writer.release()
    result = moved("day.avi", "--frames", 2)
    assert result.exit_code == 0, result.output
    assert "day.avi/000000.jpg" in result.stdout and "day.avi/000001.jpg" in result.stdout


# Pictures of another size than the reference, or of one colour, are read: their reasons are others.
REASONS = BAD_PICTURES | {"tiny.png": "has 3 x 3, reference.png", "grey.png": "only 0 matches"}


def test_bad_pictures_are_named_and_the_others_have_verdicts(folder):
    """Files and a folder; a video and an empty folder are named too."""
    paths = write_bad_pictures(folder / "bad", dense_scene.SIZE)
    (folder / "bad" / "fine.png").write_bytes((folder / "still.png").read_bytes())
    (folder / "video.mp4").write_text("not a video")
    (folder / "nothing").mkdir()
    result = moved(paths[-1], "bad", "video.mp4", "nothing", "still.png", "--json", "m.json")
    assert result.exit_code == 3, result.output
    data = json.loads((folder / "m.json").read_text())
    lines = result.stderr.splitlines()
    for path, reason in zip(paths, REASONS.values(), strict=True):
        name = path.as_posix() if path == paths[-1] else f"bad/{path.name}"
        assert data[name]["verdict"] == "cannot say" and reason in data[name]["reason"]
        named = [line for line in lines if line.startswith("bad image") and name in line]
        assert len(named) == (path.name not in ("tiny.png", "grey.png"))
    for name, reason in (("video.mp4", "not a video"), ("nothing", "no image is in this folder")):
        assert reason in data[name]["reason"]
        assert sum(name in line for line in lines) == 1
    assert data["bad/fine.png"]["verdict"] == data["still.png"]["verdict"] == "still"
    alone = moved("bad/cut.jpg", "bad/text.jpg", "--json", "none.json")
    assert_all_bad(alone, "bad/cut.jpg cannot be decoded", "bad/text.jpg is not an image")
    assert len(json.loads((folder / "none.json").read_text())) == 2


def test_unusable_input_is_one_line(folder):
    cv2.imwrite("small.png", np.zeros((100, 100, 3), np.uint8))
    (folder / "empty").mkdir()
    result = moved("small.png")  # the other pictures would stand
    assert result.exit_code == 3 and "100 x 100, reference.png has 320 x 240" in result.stdout
    assert_refused(moved("empty"), "empty: no image is in this folder")
    assert_refused(moved("missing.png"), "missing.png")
    result = run("moved", "black.png", "still.png", "--K", dense_scene.K_TEXT)
    assert_refused(result, "black.png: ", "grey levels differ by 0.0")
    assert sorted(path.name for path in folder.glob("*.json")) == []
