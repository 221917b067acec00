"""`dgc-pose moved` on warped pictures, with SIFT."""

import json

import cv2
import dense_scene
import numpy as np
import PIL.Image
import pytest
from bad_pictures import BAD_PICTURES, write_bad_pictures
from command_line import assert_all_bad, run
from PIL import ExifTags


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """reference.png; still.png, darker; later/turned.png, turned by 2 degrees; black.png."""
    monkeypatch.chdir(tmp_path)
    picture = dense_scene.pictures()[0]
    (tmp_path / "later").mkdir()
    cv2.imwrite("reference.png", picture)
    cv2.imwrite("still.png", (0.7 * picture).astype(np.uint8))
    cv2.imwrite("later/turned.png", warped(picture, 2.0))
    cv2.imwrite("black.png", 0 * picture)
    return tmp_path


def warped(picture, turn_deg=0.0, zoom=1.0):
    """The picture of a camera that turned about its vertical axis and zoomed."""
    R = cv2.Rodrigues(np.radians([0.0, turn_deg, 0.0]))[0]
    zoomed = dense_scene.K * np.array([[zoom], [zoom], [1.0]])
    zoomed[:2, 2] = dense_scene.K[:2, 2]
    H = zoomed @ R @ np.linalg.inv(dense_scene.K)
    return cv2.warpPerspective(picture, H, dense_scene.SIZE, borderMode=cv2.BORDER_REFLECT)


def write_video(path, frames):
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 5, dense_scene.SIZE)
    for frame in frames:
        writer.write(frame)
    writer.release()


def moved(*now):
    return run("moved", "reference.png", *now, "--K", dense_scene.K_TEXT, "--weights", "sift")


def test_the_table_and_the_exit_code_have_the_verdicts(folder):
    result = moved("still.png")
    assert result.exit_code == 0, result.output
    head, row, last = result.stdout.splitlines()
    assert head.split()[:3] == ["picture", "verdict", "middle"]
    assert row.startswith("still.png    still  0.0") and last == "none has moved"
    # Sixteen bits of grey, as from a thermal camera, without an edge in common.
    rng = np.random.default_rng(0)
    heat = cv2.resize(rng.random((12, 16)), dense_scene.SIZE, interpolation=cv2.INTER_CUBIC)
    cv2.imwrite("thermal.png", (27000 + 900 * heat).astype(np.uint16))
    result = moved("still.png", "black.png", "thermal.png")
    assert result.exit_code == 3 and "only 0 matches" in result.stdout
    assert "no verdict on 2 of 3" in result.stdout
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


@pytest.mark.parametrize(
    ("zoom", "verdict", "exit_code", "last"),
    [
        (1.006, "still", 0, "none has moved"),
        (1.04, "zoomed", 1, "the first that has zoomed: Tür 3.1 später.png"),
    ],
)
def test_a_zoom_is_named(folder, zoom, verdict, exit_code, last):
    """The name has blanks, umlauts and dots."""
    name = "Tür 3.1 später.png"
    cv2.imencode(".png", warped(cv2.imread("reference.png"), zoom=zoom))[1].tofile(name)
    result = moved(name, "--json", "zoomed.json")
    assert result.exit_code == exit_code, result.output
    assert "zoomed by" in result.stdout and result.stdout.endswith(last + "\n")
    motion = json.loads((folder / "zoomed.json").read_text())[name]
    assert motion["verdict"] == verdict
    assert abs(motion["zoom"] - (zoom - 1)) < motion["zoom_error_90"] < 0.01
    assert motion["middle_px"] < motion["middle_error_90_px"]
    at_corner = (zoom - 1) * np.hypot(160, 120)
    assert 0.7 * at_corner < motion["worst_px"] < at_corner + motion["worst_error_90_px"]


def test_a_video_is_taken_as_its_frames(folder):
    """A video of one second, whose camera moves."""
    still = cv2.imread("still.png")
    write_video("day.avi", [still] * 2 + [warped(still, 2.0)] * 3)
    result = moved("day.avi", "--frames", 2)
    assert result.exit_code == 1, result.output
    assert "day.avi/000000.jpg    still" in result.stdout
    assert result.stdout.endswith("the first that has moved: day.avi/000001.jpg\n")


def test_a_camera_that_hangs_upside_down(folder):
    """K is of the stored pixels: its principal point turns with the picture, once."""
    exif = PIL.Image.Exif()
    exif[ExifTags.Base.Orientation] = 3
    for name in ("reference", "later/turned"):
        picture = PIL.Image.open(f"{name}.png").rotate(180)
        picture.save(f"{name} stored.png", exif=exif)
    upright = run("moved", "reference.png", "later/turned.png", *sift("300,300,129,119.5"))
    stored = ["reference stored.png", "later/turned stored.png"]
    hanging = run("moved", *stored, *sift("300,300,190,119.5"))
    assert "rotates K with the image" in hanging.stderr
    (expected,), (found,) = (json.loads(run.stdout).values() for run in (upright, hanging))
    for motion in (expected, found):
        del motion["seconds"], motion["warnings"]
    assert expected == found and found["verdict"] == "moved"


def sift(K):
    return "--K", K, "--weights", "sift", "--json", "-"


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
