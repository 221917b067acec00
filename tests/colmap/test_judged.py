"""Judged databases, as pycolmap reads them and maps from them."""

import sqlite3
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np
import pycolmap
import pytest
from command_line import run
from given_world import GivenWorld, given_world, write_hloc, write_with_pycolmap
from worlds import K_text

from dgc_pose.metrics import rotation_error_deg

WORLD = given_world()
GOOD = 6  # its pairs of one place
QUICK = ("--runs", "1", "--iterations", "300", "--workers", "1")
HLOC_K = ("--K", "900,905,500,390")


def judged(world: GivenWorld, folder: Path, kind: str) -> tuple[Path, Path]:
    """The source, and the database that `judge` writes."""
    if kind == "hloc":
        source = write_hloc(world, folder / "h")
    else:
        source = write_with_pycolmap(world, folder / "a.db")
    out = folder / "judged.db"
    done = run("judge", source, "--out", out, *(HLOC_K if kind == "hloc" else ()), *QUICK)
    assert done.exit_code == 0, done.output
    assert f"{out}: {GOOD} pairs, for `colmap mapper`" in done.stdout
    return source, out


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return judged(WORLD, tmp_path_factory.mktemp("database"), "database")


@pytest.mark.parametrize("kind", ["database", "hloc"])
def test_the_claimed_pairs_have_geometries(
    database: tuple[Path, Path], tmp_path: Path, kind: str
) -> None:
    """With poses of the world, and inliers that are right matches."""
    source, out = database if kind == "database" else judged(WORLD, tmp_path, kind)
    with pycolmap.Database.open(out) as database:
        images = {image.image_id: image.name for image in database.read_all_images()}
        assert {*images.values()} == {*WORLD.names}
        keys, geometries = database.read_two_view_geometries()
        assert len(keys) == GOOD
        for key, geometry in zip(keys, geometries, strict=True):
            first, second = (images[i] for i in pycolmap.pair_id_to_image_pair(key))
            assert (first, second) not in WORLD.unrelated
            pose = geometry.cam2_from_cam1
            R, t = pose.rotation.matrix(), pose.translation
            assert max(WORLD.errors_deg((first, second), R, t)) < 1.5
            pair = (first, second) if (first, second) in WORLD.matches else (second, first)
            index = geometry.inlier_matches
            index = index if pair == (first, second) else index[:, ::-1]
            assert {*map(tuple, index)} <= {*map(tuple, WORLD.matches[pair])}
            assert 100 < len(index) < 200
    if kind == "database":
        with pycolmap.Database.open(source) as before, pycolmap.Database.open(out) as after:
            assert before.num_matches() == after.num_matches() == 2000
            assert before.num_keypoints() == after.num_keypoints()
            assert before.num_verified_image_pairs() == 0


def test_key_points_of_an_unusable_image_stop_no_other(tmp_path: Path) -> None:
    source = write_hloc(WORLD, tmp_path / "h")
    odd = WORLD.names[-1]
    with h5py.File(source / "feats-any.h5", "r+") as file:
        del file[f"{odd}/keypoints"]
        file[f"{odd}/keypoints"] = np.array([b"none"])
    done = run("judge", source, "--out", tmp_path / "a.db", *HLOC_K, *QUICK)
    assert done.exit_code == 0 and "bad_input 4" in done.stdout, done.output
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        images = {image.name: image.image_id for image in database.read_all_images()}
        filled = {name for name in images if database.num_keypoints_for_image(images[name])}
        assert filled == {*WORLD.names} - {odd} and database.num_verified_image_pairs() == GOOD


def test_the_room_for_a_copy_includes_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms = []
    monkeypatch.setattr(
        "dgc_pose.colmap.database.require_room", lambda path, size: rooms.append(size)
    )
    world = given_world(count=2, unrelated=0)
    source = write_with_pycolmap(world, tmp_path / "a.db")
    with closing(sqlite3.connect(source)) as log:
        log.execute("PRAGMA journal_mode = WAL")
        log.execute("PRAGMA wal_autocheckpoint = 0")
        log.execute("CREATE TABLE more AS SELECT zeroblob(1000000)")
        log.commit()
        done = run("judge", source, "--out", tmp_path / "judged.db", *QUICK)
        assert done.exit_code == 0, done.output
        assert source.stat().st_size < 10**6 < (tmp_path / "judged.db").stat().st_size
    assert rooms[0] > 2 * 10**6


def test_the_mapper_goes_on_from_there(database: tuple[Path, Path], tmp_path: Path) -> None:
    """All photographs of the place are in one model, with their true poses."""
    options = pycolmap.IncrementalPipelineOptions()
    options.min_num_matches = 15
    (tmp_path / "images").mkdir()
    models = pycolmap.incremental_mapping(
        database[1], tmp_path / "images", tmp_path / "sparse", options
    )
    (model,) = models.values()
    found = {image.name: image for image in model.images.values() if image.has_pose}
    assert {*found} == {*WORLD.names[:-1]}
    R = {name: image.cam_from_world().rotation.matrix() for name, image in found.items()}
    first = WORLD.names[0]
    true = {name: R for name, (R, _) in zip(WORLD.names, WORLD.scene.references, strict=True)}
    for name in found:
        assert rotation_error_deg(R[name] @ R[first].T, true[name] @ true[first].T) < 0.5


def test_pairs_of_points_cannot_be_written(tmp_path: Path) -> None:
    np.savez(tmp_path / "a_b.npz", points1=np.ones((30, 2)), points2=np.ones((30, 2)))
    done = run("judge", tmp_path, "--K", K_text(), "--out", tmp_path / "a.db")
    assert done.exit_code == 2 and "--out needs key points that pairs share" in done.stderr
    assert not (tmp_path / "a.db").exists()
