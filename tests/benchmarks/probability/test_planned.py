"""Plans of scenes and their parts, and their pairs: altered ones and those of each kind, mostly
against a point of their scene, a white spot in both images."""

import gzip
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes import two_view_scene
from textures import write_photos

from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.benchmarks.probability.kinds import ALTERATIONS, LIST_KINDS, altered
from dgc_pose.benchmarks.probability.planned import DEFAULT_PLAN, PlanEntry, planned, read_plan
from dgc_pose.benchmarks.probability.records import Record
from dgc_pose.cameras.pair_list import rendered_pair, write_pairs
from dgc_pose.errors import InputError
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.images.image import Image
from dgc_pose.metrics import rotation_error_deg

# Scenes that accuracy is reported on, never fitted on.
EVALUATION = ("7scenes_a", "mamechun_room", "nan_room", "eunseon_desk")
ENTRIES = [
    {"name": "a", "part": "fit", "kind": "list", "path": "a", "scene_by_folder": True},
    {"name": "b", "part": "fit", "kind": "rendered", "path": "b", "pairs": 3},
    {"name": "c", "part": "report", "kind": "unrelated", "rough": ["c"]},
]


def test_a_plan_names_its_sources_and_has_their_lists(tmp_path):
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(ENTRIES))
    found = read_plan(path)
    assert [(one.name, one.part, one.kind) for one in found] == [
        ("a", "fit", "list"),
        ("b", "fit", "rendered"),
        ("c", "report", "unrelated"),
    ]
    assert found[1].pairs == 3 and [*found[2].rough] == ["c"]
    pairs = [replace(rendered_pair(), name1=f"{place}/1.jpg", name2="2.jpg") for place in "xy"]
    for pair in pairs:
        for name in (pair.name1, pair.name2):
            (tmp_path / "a" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "a" / name).touch()
    write_pairs(tmp_path / "a.txt", pairs)
    packed = tmp_path / "a.txt.gz"
    packed.write_bytes(gzip.compress((tmp_path / "a.txt").read_bytes()))
    assert [one.scene for one in planned(found[0], tmp_path, tmp_path)] == ["x", "y"]
    entry = PlanEntry("c", "report", "unrelated", each=3)
    (tmp_path / "c.txt.gz").write_bytes(gzip.compress(b"1.jpg 2.jpg\n" * 9))
    few = planned(entry, tmp_path, tmp_path)
    assert [(one.number, one.turn) for one in few] == [(0, 0), (4, 1), (8, 2)]
    packed.write_bytes(packed.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"a\.txt\.gz cannot be read as a packed list of pairs"):
        planned(found[0], tmp_path, tmp_path)


@pytest.mark.parametrize(
    "entries",
    [
        "no plan",
        [*ENTRIES, ENTRIES[0]],  # a scene twice
        [*ENTRIES, {"name": "d", "part": "fit", "kind": "film", "path": "d"}],
        [*ENTRIES, {"name": "d", "part": "fit", "kind": "rendered", "pairs": 0}],
    ],
)
def test_what_is_no_plan_is_refused_by_its_path(entries, tmp_path):
    path = tmp_path / "plan.json"
    path.write_text(entries if isinstance(entries, str) else json.dumps(entries))
    with pytest.raises(InputError, match="plan.json"):
        read_plan(path)


def test_the_project_s_plan_fits_on_no_scene_that_it_reports_on():
    lists = DEFAULT_PLAN.parent / "lists"
    needed = set()
    for source in read_plan(DEFAULT_PLAN):
        lines = []
        if source.kind in (*LIST_KINDS, "unrelated"):
            path = lists / f"{source.listed or source.name}.txt.gz"
            needed.add(path)
            lines = gzip.decompress(path.read_bytes()).decode().splitlines()
            assert lines
        if source.part != "report":
            names = [source.path.as_posix(), *(n for line in lines for n in line.split()[:2])]
            assert not any(scene in name for name in names for scene in EVALUATION)
            assert not source.path.match("strecha")
    assert needed == {*lists.iterdir()}


def _write_list(path: Path, pairs: list[str]) -> None:
    """A packed list of pairs of images a.png, b.png and so on, by one camera that moves aside."""
    K, pose = "100 0 60 0 100 45 0 0 1", "1 0 0 0.1 0 1 0 0 0 0 1 0 0 0 0 1"
    lines = [f"{a}.png {b}.png 0 0 {K} {K} {pose}\n" for a, b in pairs]
    path.write_bytes(gzip.compress("".join(lines).encode()))


SCENE = two_view_scene("skew", count=5, outliers=0.0, sigma_px=0.0)


def _spot(points: np.ndarray, size: tuple[int, int]) -> Image:
    x, y = np.rint(points).astype(int)
    pixels = np.zeros((size[1], size[0], 3), np.uint8)
    pixels[y - 2 : y + 3, x - 2 : x + 3] = 255
    return Image(pixels)


@pytest.mark.parametrize("way", ALTERATIONS)
@pytest.mark.parametrize("number", [0, 3])
def test_the_truth_is_that_of_the_altered_images(way, number):
    camera1, camera2 = SCENE.cameras
    images = [
        _spot(points[number], camera.size)
        for points, camera in ((SCENE.points1, camera1), (SCENE.points2, camera2))
    ]
    pair = altered(PosedPair(*images, camera1, camera2, SCENE.R, SCENE.t), way)
    rays = []
    for image, camera in ((pair.image1, pair.camera1), (pair.image2, pair.camera2)):
        assert camera.size == image.size
        y, x = np.nonzero(image.pixels[..., 0] > 200)
        rays.append(camera.normalise(np.array([[x.mean(), y.mean()]])))
    E = essential_from_pose(pair.R, pair.t)
    assert sampson_distance(*rays, E)[0] * pair.camera1.focal < 1
    assert way == "darkened" or any(
        not np.array_equal(ours.pixels, image.pixels)
        for ours, image in zip((pair.image1, pair.image2), images, strict=True)
    )


def test_a_pasted_pair_keeps_a_part_of_image_2_and_has_no_pose(tmp_path):
    """Around it image 2 shows itself mirrored, or another pair's image 1."""
    rng, size = np.random.default_rng(0), (120, 90)
    for name in "abcd":
        pixels = cv2.resize(rng.integers(0, 255, (30, 40, 3), np.uint8), size)
        cv2.imwrite(str(tmp_path / f"{name}.png"), pixels)
    _write_list(tmp_path / "p.txt.gz", ["ab", "cd"])
    entry = PlanEntry("p", "fit", "pasted", seed=3)
    for number, pair in enumerate(planned(entry, tmp_path, tmp_path)):
        made, again = pair.make(), pair.make()
        assert made.R is None and made.t is None and pair.scene == "p"
        second = cv2.imread(str(tmp_path / f"{'bd'[number]}.png"))[..., ::-1]
        kept = (made.image2.pixels == second).all(-1)
        assert made.image2.size == size and 0.05 < kept.mean() < 0.7
        corners = kept[[0, 0, -1, -1], [0, -1, 0, -1]]
        assert not corners.any()
        np.testing.assert_array_equal(made.image2.pixels, again.image2.pixels)


def _white(image: Image) -> np.ndarray:
    """The middle (2,) of the white pixels."""
    y, x = np.nonzero(image.pixels.min(axis=-1) > 200)
    return np.array([x.mean(), y.mean()])


def _made(tmp_path: Path, kind: str, number: int, image1: Image, image2: Image) -> PosedPair:
    """A pair of a kind, from a list of the same pair four times."""
    for name, image in (("a", image1), ("b", image2)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image.pixels)
    _write_list(tmp_path / "s.txt.gz", 4 * ["ab"])
    entry = PlanEntry(kind, "fit", kind, seed=5, listed="s")
    first, again = (planned(entry, tmp_path, tmp_path)[number].make() for _ in "12")
    np.testing.assert_array_equal(first.image2.pixels, again.image2.pixels)
    return first


SIZE = (120, 90)
MIDDLE = _spot(np.array([60.0, 45.0]), SIZE)
ASIDE = _spot(np.array([50.0, 40.0]), SIZE)


@pytest.mark.parametrize("number", range(4))
def test_a_camera_that_turned_has_a_rotation_and_half_of_the_time_a_wrong_k(tmp_path, number):
    made = _made(tmp_path, "turned", number, MIDDLE, ASIDE)
    assert made.t is None and made.camera1 is made.camera2
    factor = made.camera1.focal / (100 / 0.6)
    if number % 2:
        assert 1.03 < max(factor, 1 / factor) < 1.4
    else:
        assert factor == pytest.approx(1)
    true = made.camera1.with_focal(100 / 0.6)
    rays = [
        np.append(true.normalise(_white(image)[None])[0], 1) for image in (made.image1, made.image2)
    ]
    np.testing.assert_allclose(rays[1], made.R @ rays[0] / (made.R @ rays[0])[2], atol=0.01)
    assert rotation_error_deg(made.R, np.eye(3)) > 3


@pytest.mark.parametrize("number", range(4))
def test_a_wrong_k_leaves_images_and_pose(tmp_path, number):
    made = _made(tmp_path, "wrong_k", number, MIDDLE, ASIDE)
    np.testing.assert_allclose(made.t, (0.1, 0, 0))
    np.testing.assert_array_equal(_white(made.image2), (50, 40))
    first, second = (camera.focal / 100 for camera in (made.camera1, made.camera2))
    assert 1.1 < max(second, 1 / second) < 1.6
    assert first == pytest.approx(second if number % 2 else 1)
    record = Record(PlanEntry("s", "fit", "wrong_k"), "s", None)
    assert not record.exact  # no expected error is fitted on it


def test_a_mirrored_pair_has_the_camera_of_the_mirror_image_and_no_pose(tmp_path):
    made = _made(tmp_path, "mirrored", 0, MIDDLE, ASIDE)
    assert made.t is None
    np.testing.assert_array_equal(_white(made.image2), (69, 40))
    np.testing.assert_allclose(made.camera2.K[:2, 2], (59, 45))


@pytest.mark.parametrize("number", range(4))
def test_a_board_has_the_pose_of_a_camera_that_moved_or_none(tmp_path, number):
    """The board shows image b; around it is a wall, or image a behind a board that moved."""
    behind = Image(np.full((*SIZE[::-1], 3), 255, np.uint8))
    made = _made(tmp_path, "board", number, behind, ASIDE)
    images = made.image1, made.image2
    if number % 2:
        assert made.t is None
        assert min((image.pixels > 200).mean() for image in images) > 0.05
        return
    rays = [made.camera1.normalise(_white(image)[None]) for image in images]
    E = essential_from_pose(made.R, made.t)
    assert sampson_distance(*rays, E)[0] * made.camera1.focal < 1


@pytest.mark.parametrize("kind", ["unrelated", "planes"])
def test_pairs_are_made_for_a_seed(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("dgc_pose.benchmarks.probability.planned.VIEW_SIZE", 160)
    names = [path.name for path in write_photos(tmp_path / "a", 60)]
    with gzip.open(tmp_path / "unrelated.txt.gz", "wt") as stream:
        stream.writelines(f"{names[k]} {names[k + 1]}\n" for k in range(8))
    source = PlanEntry(kind, "report", kind, Path("a"), pairs=8, seed=3)
    first, again = ([one.make() for one in planned(source, tmp_path, tmp_path)] for _ in "12")
    assert len({pair.image1.pixels.tobytes() + pair.image2.pixels.tobytes() for pair in first}) == 8
    for one, other in zip(first, again, strict=True):
        assert np.array_equal(one.image2.pixels, other.image2.pixels)
        assert (one.R is None) == (kind != "planes")
        assert one.camera1.size == one.image1.size
