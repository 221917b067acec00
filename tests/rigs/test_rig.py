"""Fixed cameras of a rendered scene by photographs of a walk, with the shipped network."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest
from bad_pictures import BAD_PICTURES, write_bad_pictures
from scipy.spatial.transform import Rotation
from worlds import (
    SIZE,
    K_text,
    draw_textures,
    known_model,
    look_at,
    render,
    render_views,
    write_views,
)

from dgc_pose.batch.options import BatchOptions
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.localization.locate import Locator
from dgc_pose.localization.location import Location
from dgc_pose.matchers import MatcherOptions
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.model import Model, load_model
from dgc_pose.rigs.rig import Rig, _checked, _same_poses, estimate_rig

K = np.array([[180.0, 0, 120], [0, 180, 89.5], [0, 0, 1]])  # of the fixed cameras
CENTRES = {"north": (-0.7, -0.5, 0.3), "south": (0.8, -0.3, -0.4), "west": (0.1, 0.4, 0.5)}
CENTRES["zoo"] = CENTRES["west"]  # in another scene
TRUE = {name: (look_at(np.array(c), np.array([0, 0.2, 4.6])), c) for name, c in CENTRES.items()}
FAST = EstimationOptions(effort="fast", runs=1, iterations=300)
RESULTS = {"rig_pictures", "sparse", "points.ply"}
QUICK = {"estimation": FAST, "work": BatchOptions(workers=1)}


def write_cameras(folder: Path, *names: str) -> Path:
    """Pictures of the cameras."""
    folder.mkdir()
    for name in names:
        textures = draw_textures(9 * (name == "zoo"))
        pixels, _ = render(TRUE[name][0], np.array(TRUE[name][1]), textures, K)
        cv2.imwrite(str(folder / f"{name}.png"), pixels[:, :, ::-1])
    return folder


def walk_model(folder: Path, second: str = "view1.png") -> Model:
    """Three photographs with their true poses."""
    model = known_model(folder, render_views(3, step=0.8))
    (folder / "view1.png").rename(folder / second)
    for facts in (model.poses, model.cameras):
        facts[second] = facts.pop("view1.png")
    return model


def assert_true(rig: Rig, names: str, frame: pycolmap.Sim3d) -> None:
    """The placed cameras are where they were rendered, within three times the stated errors.
    frame: from the world to that of the rig."""
    assert [*rig.placed] == names.split(), rig.cameras
    for name, camera in rig.placed.items():
        off_deg = rotation_error_deg(camera.R @ frame.rotation.matrix(), TRUE[name][0])
        assert off_deg < 3 * camera.rotation_error_90_deg < 6
        off = np.linalg.norm(camera.centre - frame * np.array(TRUE[name][1]))
        assert off < 3 * camera.position_error_90 < frame.scale
        assert camera.camera.size == SIZE and camera.probability > 0.9


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Rig]:
    folder = tmp_path_factory.mktemp("rig")
    frames = write_cameras(folder / "frames", "north", "south", "zoo")
    walk, known = walk_model(folder / "walk", "north.png"), {"south": K, "zoo": K}
    metres = ReconstructionOptions(scale="north,south,3.0")
    made = estimate_rig(frames, folder / "out", walk, K=known, reconstruction=metres, **QUICK)
    return folder, made


def test_cameras_are_placed_in_a_model_in_metres(placed: tuple[Path, Rig]) -> None:
    """Also one without a K; a K that is given stays. A camera of another scene has the reason, and
    a photograph of the walk may have the name of a camera's picture."""
    rig = placed[1]
    assert (rig.metric["unit"], rig.warnings) == ("m", ())
    scale = 3.0 / np.linalg.norm(np.subtract(CENTRES["north"], CENTRES["south"]))
    assert_true(rig, "north south", pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.zeros(3)))
    north, south, zoo = rig.cameras.values()
    assert np.linalg.norm(north.centre - south.centre) == pytest.approx(3.0)
    np.testing.assert_array_equal(south.camera.K, K)
    assert south.camera.exact and not north.camera.exact
    assert abs(north.camera.focal / 180 - 1) < 3 * north.camera.focal_std < 0.1
    assert zoo.centre is None and "pictures between zoo and " in zoo.reason


def test_the_model_is_written_but_not_over_another(placed: tuple[Path, Rig]) -> None:
    folder, rig = placed
    out = folder / "out"
    assert {path.name for path in out.iterdir()} == RESULTS
    model = load_model(out / "sparse", rig.model.root)
    for name, camera in rig.placed.items():
        stored = f"out/rig_pictures/cameras/{name}.png"
        np.testing.assert_allclose(model.poses[stored], camera.cam_from_world, atol=1e-9)
        np.testing.assert_allclose(model.cameras[stored].K, camera.camera.K, atol=1e-9)
    assert sum(name.startswith("walk/") for name in model.poses) == 3 and len(model.poses) == 5
    with pytest.raises(InputError, match="sparse exists already: resume continues"):
        estimate_rig(folder / "frames", out, folder / "walk", **QUICK)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"marker": 0.2}, "^marker finds no marker in two of the 6 images$"),
        ({"gps": True}, "^gps needs 3 positions, and 0 of 6 photographs have a GPS position$"),
        ({"scale": "north,east,3"}, "^scale must be two of the 3 images .*'north,east,3'$"),
    ],
)
def test_no_metres_are_told_before_the_matching(
    placed: tuple[Path, Rig], options: dict[str, object], why: str
) -> None:
    """The results of an earlier run stay."""
    folder, _ = placed
    again = QUICK | {"work": BatchOptions(workers=1, resume=True)}
    metres = ReconstructionOptions(**options)
    with pytest.raises(InputError, match=why):
        estimate_rig(
            folder / "frames", folder / "out", folder / "walk", reconstruction=metres, **again
        )
    assert {path.name for path in (folder / "out").iterdir()} == RESULTS


def test_a_batch_that_is_refused_leaves_the_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The results are those of an earlier run; one that ends without a model, as cameras that
    share nothing have none, removes them."""

    def refuse(*_: object, **__: object) -> None:
        raise InputError("other settings")

    frames, out = write_cameras(tmp_path / "frames", "north", "zoo"), tmp_path / "out"
    (out / "sparse").mkdir(parents=True)
    earlier = [
        out / name for name in ("rig.json", "points.ply", "model.html", "sparse/cameras.bin")
    ]
    for path in earlier:
        path.write_text("")
    again = QUICK | {"work": BatchOptions(workers=1, resume=True)}
    with monkeypatch.context() as patched, pytest.raises(InputError, match="other settings"):
        patched.setattr("dgc_pose.rigs.rig.run_batch", refuse)
        estimate_rig(frames, out, **again)
    assert all(path.exists() for path in earlier)
    rig = estimate_rig(frames, out, **again)
    assert rig.model is None and not any(path.exists() for path in earlier)
    assert not rig.placed and [*rig.cameras] == ["north", "zoo"]
    reason = "the cameras' own pictures make no model (0 of 1 pairs have a pose, 1 "
    for camera in rig.cameras.values():
        assert camera.reason.startswith(reason) and "photographs" in camera.reason


def test_the_mask_of_a_camera_is_not_that_of_a_photograph(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The walk has a photograph of the same name."""
    frames = write_cameras(tmp_path / "frames", "north", "south")
    picture = cv2.imread(str(frames / "north.png"))
    (frames / "north.png").unlink()
    (frames / "north").mkdir()
    for number in range(4):  # something white comes and goes at the lower edge
        frame = picture.copy()
        frame[-40:] = 255 * (number % 2) + frame[-40:] * (1 - number % 2)
        cv2.imwrite(str(frames / "north" / f"{number}.png"), frame)
    made = list[Locator]()

    def locator(*arguments: object) -> Locator:
        made.append(Locator(*arguments))
        return made[-1]

    monkeypatch.setattr("dgc_pose.rigs.rig.Locator", locator)
    walk = walk_model(tmp_path / "walk", "north.png")
    rig = estimate_rig(frames, tmp_path / "out", walk, K={"north": K, "south": K}, **QUICK)
    assert_true(rig, "north south", pycolmap.Sim3d())
    assert (tmp_path / "out" / "rig_pictures" / "masks" / "north.png.png").is_file()
    assert made[0].image("north.png").mask is None
    seen = np.concatenate([image.matches.points2 for image in rig.cameras["north"].database_images])
    assert len(seen) and seen[:, 1].max() < 150


def test_without_a_model_each_camera_has_a_reason(tmp_path: Path) -> None:
    """Bad pictures have their own, with a walk or alone; a bad one of the walk is told."""
    bad = [path for path in write_bad_pictures(tmp_path / "frames") if path.exists()]
    sift = QUICK | {"matcher": MatcherOptions("sift")}
    alone = estimate_rig(tmp_path / "frames", tmp_path / "none", **sift)
    assert {location.status for location in alone.cameras.values()} == {"bad_input"}
    assert not alone.warnings and len(alone.cameras) == len(bad)
    pixels = np.random.default_rng(0).integers(0, 256, (3, *SIZE[::-1], 3), np.uint8)
    cv2.imwrite(str(tmp_path / "frames" / "north.png"), pixels[0])
    scale = ReconstructionOptions(scale="north,empty,3.0")
    with pytest.raises(InputError, match=r"^scale names empty, whose picture .*empty\.jpg: empty$"):
        estimate_rig(tmp_path / "frames", tmp_path / "none", reconstruction=scale, **sift)
    walk = tmp_path / "walk"
    write_bad_pictures(walk)
    for number in (1, 2):
        cv2.imwrite(str(walk / f"{number}.png"), pixels[number])
    known = {"north": K, "text": K, "grey": K}
    own = estimate_rig(tmp_path / "frames", tmp_path / "own", K=known, **sift)
    assert own.warnings == () and own.cameras["north"].status == "nowhere"
    rig = estimate_rig(tmp_path / "frames", tmp_path / "out", walk, K=known, **sift)
    assert rig.model is None and {*rig.cameras} == {"north"} | {path.stem for path in bad}
    for path in bad:
        location = rig.cameras[path.stem]
        assert location.status == "bad_input" and BAD_PICTURES[path.name] in location.reason
    assert rig.cameras["north"].status == "nowhere"
    assert "the walk makes no model" in rig.cameras["north"].reason
    told = [name for name in BAD_PICTURES if any(name in line for line in rig.warnings)]
    assert told == [path.name for path in bad]


def test_a_camera_and_a_photograph_that_are_of_no_use_are_told(tmp_path: Path) -> None:
    """Metres between cameras of which one has no place, which is known only after the matching,
    leave the rig up to scale. An image of the model that cannot be read counts not among those of
    which two must agree with a camera, or all but one."""
    frames = write_cameras(tmp_path / "frames", "north", "south", "zoo")
    walk, known = walk_model(tmp_path / "walk"), dict.fromkeys(("north", "south", "zoo"), K)
    path = tmp_path / "walk" / "view0.png"
    path.write_bytes(path.read_bytes()[:-9000])
    metres = ReconstructionOptions(scale="north,zoo,3.0")
    rig = estimate_rig(frames, tmp_path / "out", walk, K=known, reconstruction=metres, **QUICK)
    assert str(rig.not_in_metres) == "scale names zoo, which has no place" and not rig.metric
    assert_true(rig, "north south", pycolmap.Sim3d())
    assert (tmp_path / "out" / "sparse" / "cameras.bin").is_file()
    (warning,) = rig.warnings
    assert warning.startswith(f"{path} is corrupt")
    north = rig.cameras["north"]
    one, two = north.database_images
    assert {one.name, two.name} == {"view1.png", "view2.png"} and one.agrees and two.agrees
    alone = replace(north, database_images=(one, replace(two, agrees=False)))
    whole = SimpleNamespace(model=walk, bad={})
    assert _checked(alone, "north", whole).status == "nowhere"
    corrupt = SimpleNamespace(model=walk, bad={path.name: "corrupt"})
    assert _checked(alone, "north", corrupt) is alone


def frame_of(poses: dict[str, np.ndarray], true: dict[str, np.ndarray]) -> pycolmap.Sim3d:
    """From the world to a model's frame, by all rotations and the spread of the centres."""
    turns = [poses[n][:, :3].T @ true[n][:, :3] for n in true]
    turn = Rotation.from_matrix(turns).mean().as_matrix()
    centres = [np.stack([-p[n][:, :3].T @ p[n][:, 3] for n in true]) for p in (true, poses)]
    before, after = (float(np.linalg.norm(at - at.mean(0))) for at in centres)
    shift = centres[1].mean(0) - after / before * turn @ centres[0].mean(0)
    return pycolmap.Sim3d(after / before, pycolmap.Rotation3d(turn), shift)


@pytest.mark.slow
def test_a_walk_becomes_the_model_and_is_adjusted_with_the_cameras(tmp_path: Path) -> None:
    frames = write_cameras(tmp_path / "frames", "north", "south", "zoo")
    views, walk, out = render_views(5, step=0.5), tmp_path / "walk", tmp_path / "out"
    names = [f"walk/{name}" for name in write_views(walk, views)]
    rig = estimate_rig(frames, out, walk, K={"south": K}, walk_K=K_text(), **QUICK)
    true = {n: np.column_stack([view.R, view.t]) for n, view in zip(names, views, strict=True)}
    assert_true(rig, "north south", frame_of(rig.model.poses, true))
    np.testing.assert_allclose(rig.cameras["south"].camera.K, K, atol=1e-9)
    for name in rig.placed:
        image = rig.model.colmap.find_image_with_name(f"out/rig_pictures/cameras/{name}.png")
        assert image is not None and image.num_points3D > 100


@pytest.mark.slow
def test_without_a_walk_the_pictures_are_the_model(tmp_path: Path) -> None:
    """A K that is given stays, also beside others that are not."""
    names = ("north", "south", "west")
    frames = write_cameras(tmp_path / "frames", *names)
    rig = estimate_rig(frames, tmp_path / "out", K={"south": K}, **QUICK)
    true = {n: np.column_stack([TRUE[n][0], -TRUE[n][0] @ TRUE[n][1]]) for n in names}
    poses = {name: rig.cameras[name].cam_from_world for name in names}
    assert_true(rig, "north south west", frame_of(poses, true))
    np.testing.assert_allclose(rig.cameras["south"].camera.K, K, atol=1e-9)


@pytest.mark.parametrize(("unit", "distance"), [("m", "0.01 m apart"), ("", "0.01 apart")])
def test_cameras_with_one_pose_are_told(unit: str, distance: str) -> None:
    """Those that are nearer to each other than their errors, in angle and distance."""
    covariance = np.diag([1e-6] * 3 + [1e-4] * 3)
    cameras = {
        name: Location("located", "", (), np.eye(3), np.array([x, 0, 0]), covariance=covariance)
        for name, x in (("door", 0.0), ("pole", 0.01), ("desk", 1.0))
    }
    (warning,) = _same_poses(cameras, unit)
    end = f"they are 0 degrees and {distance}"
    assert warning == f"door and pole have the same pose: {end}"
