"""Models of known cameras brought into metres."""

import json
from pathlib import Path

import numpy as np
import PIL.Image
import pycolmap
import pytest
from batch_runs import view_folder
from command_line import assert_refused, run
from marker_scene import draw_markers, square, texture
from scipy.spatial.transform import Rotation
from worlds import K_text, colmap_model

from dgc_pose import InputError
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.reconstruction import MappingError, known_metres, to_metres

LATITUDE, LONGITUDE, ALTITUDE = -33.8568, -70.2153, 1210.0  # south and west
NAMES = [f"view{n}.png" for n in range(6)]
GPS = ReconstructionOptions(gps=True)


def tag(path: Path, enu: np.ndarray) -> None:
    """Write GPS tags of a place (3,), metres east, north and up, into a photograph."""
    of_earth = pycolmap.GPSTransform()
    *angles, altitude = of_earth.enu_to_ellipsoid(enu[None], LATITUDE, LONGITUDE, ALTITUDE)[0]
    south, west = ((int(-a), int(-a * 60) % 60, -a * 3600 % 60) for a in angles)
    exif = PIL.Image.Exif()
    exif[271] = "Maker"  # Pillow writes no block of GPS alone
    exif.get_ifd(34853).update({1: "S", 2: south, 3: "W", 4: west, 5: 0, 6: altitude})
    PIL.Image.new("RGB", (40, 30)).save(path, exif=exif)


def paths(folder: Path, count: int = 6) -> dict[str, Path]:
    return {name: folder / name for name in NAMES[:count]}


def places(seed: int = 0) -> np.ndarray:
    """East, north, up (6, 3), metres: a walk; the first is the origin."""
    walk = np.random.default_rng(seed).uniform(-60, 60, (6, 3)) * (1, 1, 0.1)
    return walk - walk[0]


TURN = Rotation.from_euler("xyz", [0.4, -0.3, 0.2])  # of the cameras of a model


def model_of(
    centres: np.ndarray,
    rotation: Rotation = TURN,
    params: tuple[float, ...] = (30.0, 30.0, 20.0, 15.0),
) -> pycolmap.Reconstruction:
    """A model with a camera at each centre (N, 3), all of one rotation."""
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=params)
    R = rotation.as_matrix()
    return colmap_model(NAMES[: len(centres)], [(R, centre) for centre in centres], camera)


def centres_of(model: pycolmap.Reconstruction) -> np.ndarray:
    by_name = {image.name: image.projection_center() for image in model.images.values()}
    return np.array([by_name[name] for name in sorted(by_name)])


@pytest.mark.parametrize("wrong", [0, 300])
def test_gps_gives_metres_east_north_and_up(tmp_path: Path, wrong: float) -> None:
    """Also where one position is wrong, which counts as none."""
    true = places()
    noise = np.random.default_rng(1).normal(0, 0.5, true.shape)
    for number, name in enumerate(NAMES):
        tag(tmp_path / name, true[number] + noise[number] + (wrong * (number == 4), 0, 0))
    turn = Rotation.from_euler("xyz", [1.0, 0.5, -2.0]).as_matrix()
    model = model_of(0.013 * true @ turn.T + (3, -2, 8))
    facts = to_metres(model, paths(tmp_path), GPS)
    assert np.linalg.norm(centres_of(model) - (true - noise[0]), axis=1).max() < 2
    assert facts["unit"] == "m" and facts["frame"].startswith("east, north, up; origin at -33.85")
    assert 0.1 < facts["median_gps_residual_m"] < 2
    assert abs(facts["largest_gps_residual_m"] - wrong) < 2


@pytest.mark.parametrize("axis", ["y", "z"], ids=["upright", "from above"])
def test_noise_turns_no_small_survey_upside_down(tmp_path: Path, axis: str) -> None:
    """Six photographs within 3 m, of one altitude, and positions that err by as much along each
    axis. pycolmap alone has 10 of these 30 upside down."""
    down, upside_down = Rotation.from_euler("x", 90 if axis == "y" else 180, degrees=True), 0
    of_model = (TURN.inv() * down).as_matrix()  # from east, north and up
    for seed in range(30):
        rng = np.random.default_rng(seed)
        true = rng.uniform(0, 3, (6, 3)) * (1, 1, 0) + rng.normal(0, 0.1, (6, 3))
        for name, place in zip(NAMES, true + rng.normal(0, 3, true.shape), strict=True):
            tag(tmp_path / name, place)
        model = model_of(0.02 * true @ of_model.T)
        to_metres(model, paths(tmp_path), GPS)
        lower = model.images[1].cam_from_world().rotation.matrix()["xyz".index(axis)]
        upside_down += lower[2] > 0
    assert upside_down <= 4


def test_positions_that_do_not_agree_are_told(tmp_path: Path) -> None:
    for name, place in zip(NAMES, 1000 * places(), strict=True):
        tag(tmp_path / name, place)
    rng = np.random.default_rng(3)
    with pytest.raises(MappingError, match="no similarity brings 6 cameras to 15 m from"):
        to_metres(model_of(rng.standard_normal((6, 3))), paths(tmp_path), GPS)


@pytest.mark.parametrize(
    ("count", "words"), [(2, "2 of 6 photographs have a GPS position"), (6, "6 positions on one")]
)
def test_few_positions_or_a_line_of_them_are_refused(
    tmp_path: Path, count: int, words: str
) -> None:
    for number, name in enumerate(NAMES):
        PIL.Image.new("RGB", (40, 30)).save(tmp_path / name)
        if number < count:
            tag(tmp_path / name, number * np.array([20.0, 5.0, 0.1]))
    with pytest.raises(InputError, match=words):
        known_metres(paths(tmp_path), GPS)


def test_the_distance_of_two_cameras_gives_the_scale(tmp_path: Path) -> None:
    true = places()
    model = model_of(0.02 * true)
    metres = float(np.linalg.norm(true[1] - true[4]))
    options = ReconstructionOptions(scale=f"{NAMES[1]},{NAMES[4]},{metres}")
    facts = to_metres(model, paths(tmp_path), options)
    assert facts == {"unit": "m", "frame": "the model's own"}
    np.testing.assert_allclose(centres_of(model), true, atol=1e-6)
    assert to_metres(model, paths(tmp_path), ReconstructionOptions()) == {}
    with pytest.raises(InputError, match="view4.png is not in the model"):
        to_metres(model_of(true[:4]), paths(tmp_path), options)


def test_a_marker_gives_the_scale(tmp_path: Path) -> None:
    """Of a model in another unit, by pictures of three of its cameras. A second marker moves before
    the last one."""
    K, name = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), "APRILTAG_36h11:4"
    true = np.array([[-0.4, 0, 0], [0, 0.1, 0], [0.4, 0, 0]])  # metres
    model = model_of(0.3 * true, Rotation.identity(), (600, 600, 320.5, 240.5))
    for number, centre in enumerate(true, start=1):
        markers = {name: square(0.2, (0, 0, 2), (0.3, 0.1, 0))}
        markers["APRILTAG_36h11:5"] = square(0.2, (0.2, 0.3 + 0.05 * (number == 3), 2))
        pose = np.column_stack([np.eye(3), -centre])
        pixels = draw_markers(texture((640, 480), number), K, pose, markers, number)
        PIL.Image.fromarray(pixels).save(tmp_path / NAMES[number - 1])
    facts = to_metres(model, paths(tmp_path, 3), ReconstructionOptions(marker=0.2))
    assert (facts["unit"], facts["frame"]) == ("m", "the model's own")
    assert facts["marker_images"] == {name: 3, "APRILTAG_36h11:5": 2}
    assert 0.001 < facts["scale_relative_std"] < 0.01
    moved = "marker APRILTAG_36h11:5 is a square under the poses of 2 of its 3 images: it is used"
    assert facts["warnings"] == [moved]
    np.testing.assert_allclose(centres_of(model), true, atol=0.004)
    for image in NAMES[:3]:
        PIL.Image.fromarray(texture((640, 480))).save(tmp_path / image)
    with pytest.raises(InputError, match="two of the 3 images$"):
        to_metres(model, paths(tmp_path, 3), ReconstructionOptions(marker=0.2))


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "photos"
    first, *_, last = (view.centre for view in view_folder(folder))
    metres = 7.5 * np.linalg.norm(last - first)
    PIL.Image.fromarray(texture((240, 180))).save(folder / "other.png")
    fast = ("--K", K_text(), "--weights", "sift", "--runs", 1, "--workers", 1)
    words = ("reconstruct", folder, "--out", tmp_path / "out", *fast)
    for scale in ("nosuch.png,2", "view1.png,0", "view0.png,2"):
        refused = run(*words, "--scale", f"view0.png,{scale}")
        assert_refused(refused, "--scale must be two of the 5 images (such as")
        assert not (tmp_path / "out").exists()
    for option in (("--gps",), ("--marker", 0.2)):
        assert_refused(run(*words, *option), option[0])
        assert not (tmp_path / "out").exists()
    result = run(*words, "--scale", f"view0.png,view3.png,{metres}")
    assert result.exit_code == 0, result.output
    assert "unit: m\nframe: " in result.stdout
    assert '"unit": "m"' in (tmp_path / "out" / "summary.json").read_text()
    centres = centres_of(pycolmap.Reconstruction(tmp_path / "out" / "sparse"))
    assert np.linalg.norm(centres[3] - centres[0]) == pytest.approx(metres)
    result = run(*words, "--resume", "--scale", f"view0.png,other.png,{metres}")
    assert result.exit_code == 2
    assert result.stderr.endswith("sparse is up to scale: --scale other.png is not in the model\n")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["registered"] == 4 and "unit" not in summary
    assert summary["not_in_metres"] == "scale other.png is not in the model"
    assert pycolmap.Reconstruction(tmp_path / "out" / "sparse").num_reg_images() == 4

    def fails(*arguments: object) -> None:
        raise RuntimeError("of pycolmap's own")

    monkeypatch.setattr(pycolmap, "incremental_mapping", fails)
    result = run(*words, "--resume")
    assert result.exit_code == 2 and "no model" not in result.output
    assert "database.db: pycolmap: of pycolmap's own" in result.stderr
