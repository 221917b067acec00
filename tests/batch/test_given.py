"""The sources of matches that another program made, against pycolmap and a schema of COLMAP 3."""

import sqlite3
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np
import pycolmap
import pytest
from given_world import COLMAP_CENTRE, given_world, write_hloc, write_npz, write_with_pycolmap
from worlds import CAMERA, IMAGE

from dgc_pose.batch.given import read_given
from dgc_pose.batch.given.matches import GivenMatches, IndexedMatches
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Header

WORLD = given_world()
PAIR = WORLD.names[1], WORLD.names[3]
POINT = np.array([[1.0, 2.0]])
MAX_IMAGES = 2**31 - 1  # of COLMAP: pair_id is id1 * MAX_IMAGES + id2, id1 < id2
SCHEMA_3 = """
CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, model INTEGER NOT NULL,
    width INTEGER NOT NULL, height INTEGER NOT NULL, params BLOB,
    prior_focal_length INTEGER NOT NULL);
CREATE TABLE images (image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    name TEXT NOT NULL UNIQUE, camera_id INTEGER NOT NULL, prior_qw REAL, prior_qx REAL,
    prior_qy REAL, prior_qz REAL, prior_tx REAL, prior_ty REAL, prior_tz REAL);
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB);
CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB);
CREATE TABLE matches (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB);
CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB, config INTEGER NOT NULL, F BLOB, E BLOB, H BLOB, qvec BLOB,
    tvec BLOB);
"""


def write_colmap_3(path: Path) -> Path:
    """The world as COLMAP 3.8 has it, with key points of two columns. The ids of the images are in
    reverse order of their names."""
    K = CAMERA.K
    parameters = np.array([K[0, 0], K[1, 1], K[0, 2] + COLMAP_CENTRE, K[1, 2] + COLMAP_CENTRE])
    ids = {name: len(WORLD.names) - number for number, name in enumerate(WORLD.names)}
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(SCHEMA_3)
        camera = (1, 1, *IMAGE, parameters.tobytes(), 1)
        database.execute("INSERT INTO cameras VALUES (?, ?, ?, ?, ?, ?)", camera)
        for name, points in WORLD.key_points.items():
            insert = "INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, 1)"
            database.execute(insert, (ids[name], name))
            data = (points + COLMAP_CENTRE).astype("<f4").tobytes()
            row = (ids[name], len(points), 2, data)
            database.execute("INSERT INTO keypoints VALUES (?, ?, ?, ?)", row)
        for (first, second), index in WORLD.matches.items():
            key = ids[second] * MAX_IMAGES + ids[first]
            data = index[:, ::-1].astype("<u4").tobytes()
            row = (key, len(index), 2, data)
            database.execute("INSERT INTO matches VALUES (?, ?, ?, ?)", row)
    return path


def write_geometries(path: Path) -> Path:
    """Every second match of each pair as an inlier, and no raw matches."""
    write_with_pycolmap(WORLD, path)
    with pycolmap.Database.open(path) as database:
        pairs, matches = database.read_all_matches()
        for key, index in zip(pairs, matches, strict=True):
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = index[::2]
            database.write_two_view_geometry(*pycolmap.pair_id_to_image_pair(key), geometry)
        database.clear_matches()
    return path


def assert_the_world(given: GivenMatches, step: int = 1, sizes: bool = True) -> None:
    """All its images and pairs, in either order, with their matched points."""
    assert {*given.names} == {*WORLD.names} and len(given.places) == len(WORLD.matches)
    assert given.sizes == (dict.fromkeys(WORLD.names, IMAGE) if sizes else {})
    for names in WORLD.matches:
        there = names in given.places
        found = given.read(names) if there else given.read(names[::-1]).swapped()
        expected = np.column_stack(WORLD.points(names))[::step]
        read = np.column_stack([found.points1, found.points2])
        order, same = (np.lexsort(np.rint(a * 100).T) for a in (read, expected))
        assert np.abs(read[order] - expected[same]).max() < 1e-3  # float32
        assert found.key_points and found.error_px == 1


@pytest.mark.parametrize("columns", [2, 4, 6])
def test_a_database_of_pycolmap(tmp_path: Path, columns: int) -> None:
    given = read_given(write_with_pycolmap(WORLD, tmp_path / "a.db", columns=columns))
    assert_the_world(given)
    camera = given.cameras[PAIR[0]]
    assert np.allclose(camera.K, CAMERA.K) and camera.size == IMAGE
    assert "(0.5, 0.5): 0.5 is subtracted" in given.notes[0] and len(given.notes) == 1
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        id1, id2 = (database.read_image_with_name(name).image_id for name in PAIR)
        assert isinstance(given, IndexedMatches)
        index, confidence = given.indices(PAIR[::-1])  # the ids are in reverse order
        assert np.array_equal(index, database.read_matches(id2, id1)) and (confidence == 1).all()
        points = database.read_keypoints(id1)[:, :2] - COLMAP_CENTRE
        assert np.array_equal(given.key_points(PAIR[0]).points, points.astype(np.float64))


def test_a_database_of_colmap_3(tmp_path: Path) -> None:
    """It stays as it is, on a folder that cannot be written either."""
    path = write_colmap_3(tmp_path / "a.db")
    before = path.read_bytes()
    tmp_path.chmod(0o500)
    given = read_given(path)
    assert_the_world(given)
    tmp_path.chmod(0o700)
    assert path.read_bytes() == before and np.allclose(given.cameras[PAIR[0]].K, CAMERA.K)


def test_a_database_with_a_log(tmp_path: Path) -> None:
    """What SQLite has not yet moved into the file counts."""
    path = write_with_pycolmap(WORLD, tmp_path / "a.db")
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        shifted = np.ones((200, 2), "<f4").tobytes()
        database.execute("UPDATE keypoints SET data = ?, cols = 2", (shifted,))
        database.commit()
        assert (tmp_path / "a.db-wal").stat().st_size
        given = read_given(path)
        before = given.state
        assert (given.read(PAIR[::-1]).points1 == 1 - COLMAP_CENTRE).all()
        assert given.state == before  # which reading does not change
        assert given.files() == [path, tmp_path / "a.db-wal"]
        database.execute("UPDATE keypoints SET data = ?", (shifted[::-1],))
        database.commit()
        assert given.state != before


def test_inliers_stand_for_matches_that_are_missing(tmp_path: Path) -> None:
    given = read_given(write_geometries(tmp_path / "a.db"))
    assert "their inliers are judged" in given.notes[1]
    assert_the_world(given, step=2)


def test_a_focal_length_that_is_no_prior_is_not_known(tmp_path: Path) -> None:
    given = read_given(write_with_pycolmap(WORLD, tmp_path / "a.db", known=False))
    assert not given.cameras and given.sizes[PAIR[0]] == IMAGE


@pytest.mark.parametrize("mark", ["/", "_"])
def test_files_of_hloc(tmp_path: Path, mark: str) -> None:
    """By any names, with names in subfolders, and pairs by the separators of old and new."""
    given = read_given(write_hloc(WORLD, tmp_path / "h", mark))
    assert_the_world(given)
    assert given.read(PAIR).confidence[0] == pytest.approx(0.9, abs=1e-3)
    assert "(0, 0), as here" in given.notes[0]
    for uncertainties, error_px in (((None, 2.5), 2.5), ((0.5, 0.7), 0.7), ((0.5, None), 1.0)):
        with h5py.File(tmp_path / "h/feats-any.h5", "r+") as file:
            for name, uncertainty in zip(PAIR, uncertainties, strict=True):
                attributes = file[f"{name}/keypoints"].attrs
                attributes.pop("uncertainty", None)
                if uncertainty is not None:
                    attributes["uncertainty"] = uncertainty
        assert read_given(tmp_path / "h").read(PAIR).error_px == error_px


@pytest.mark.parametrize("named", [True, False])
def test_a_folder_of_npz(tmp_path: Path, named: bool) -> None:
    given = read_given(write_npz(WORLD, tmp_path / "n", named=named))
    if named:
        assert_the_world(given, sizes=False)
    else:
        assert given.names == tuple(Path(name).name for name in WORLD.names)
    assert given.upright and len(given.places) == len(WORLD.matches)


def _npz(path: Path, **arrays: object) -> Path:
    path.parent.mkdir(exist_ok=True)
    np.savez(path, points1=POINT, points2=POINT, **arrays)  # type: ignore[arg-type]
    return path.parent


@pytest.mark.parametrize(
    ("file", "names"),
    [
        ("a_b", ("a", "b")),
        ("IMG_0001.JPG_IMG_0002.JPG", ("IMG_0001.JPG", "IMG_0002.JPG")),
        ("IMG_1.jpg_b_2.png", ("IMG_1.jpg", "b_2.png")),
        ("2024.05.01_7.jpg_2024.05.01_8.jpg", ("2024.05.01_7.jpg", "2024.05.01_8.jpg")),
        ("a.jpg_b", ("a.jpg", "b")),
        ("a.b_c.jpg_d.jpg", None),
        ("a_b_c", None),
        ("_a", None),
    ],
)
def test_the_names_of_an_npz_by_its_own(
    tmp_path: Path, file: str, names: tuple[str, str] | None
) -> None:
    """If it can be read in one way alone; also of a file that is damaged, until it is read."""
    folder = _npz(tmp_path / "n" / f"{file}.npz")
    if names is None:
        with pytest.raises(InputError, match=r"NAME1_NAME2.npz in [02] ways"):
            read_given(folder)
        return
    assert [*read_given(folder).places] == [names]
    (folder / f"{file}.npz").write_bytes(b"PK")
    given = read_given(folder)
    assert [*given.places] == [names]
    with pytest.raises(InputError, match="cannot be read as"):
        given.read(names)


def test_what_an_npz_states(tmp_path: Path) -> None:
    """Its images, in any kind of array, and whether its matches are of key points."""
    path = tmp_path / "n/a_b.npz"
    for image1, image2 in (("a.jpg", "b.jpg"), (["a.jpg"], ["b.jpg"]), (b"a.jpg", [b"b.jpg"])):
        given = read_given(_npz(path, image1=image1, image2=image2))
        assert [*given.places] == [("a.jpg", "b.jpg")]
    for stated, expected in (({}, False), ({"key_points": True}, True), ({"key_points": 0}, False)):
        given = read_given(_npz(path, **stated))
        assert given.read(("a", "b")).key_points is expected
    with pytest.raises(InputError, match=r"a_b.npz cannot be read as names of images"):
        read_given(_npz(path, image1=["a", "b"], image2="c"))


def test_a_pair_that_is_there_twice_is_told(tmp_path: Path) -> None:
    for file in ("a_b", "b_a", "c_a"):
        _npz(tmp_path / "n" / f"{file}.npz")
    given = read_given(tmp_path / "n")
    assert [*given.places] == [("a", "b"), ("c", "a")]
    first, second = given.notes
    assert first.startswith("3 .npz: ")
    assert second.endswith("left out, as their pairs have some already: 1 (first: b_a.npz)")
    write_hloc(WORLD, tmp_path / "h")
    with h5py.File(tmp_path / "h/feats-any_matches-any.h5", "r+") as file:
        names = [name.replace("/", "-") for name in PAIR]
        file.copy("/".join(names), "/".join(reversed(names)))
    given = read_given(tmp_path / "h")
    assert len(given.places) == len(WORLD.matches) and "some already: 1" in given.notes[1]


@pytest.mark.parametrize("rows", [-1, 1])
def test_matches_of_other_key_points_are_no_matches(tmp_path: Path, rows: int) -> None:
    """hloc has one row for each key point of image 1."""
    given = read_given(write_hloc(WORLD, tmp_path / "h"))
    with h5py.File(tmp_path / "h/feats-any_matches-any.h5", "r+") as file:
        group = file["/".join(name.replace("/", "-") for name in PAIR)]
        stored = group["matches0"][:]
        del group["matches0"]
        group["matches0"] = np.resize(stored, len(stored) + rows)
    with pytest.raises(
        InputError, match=rf"matches0 has {len(stored) + rows} rows for {len(stored)}"
    ):
        given.read(PAIR)


def test_the_state_changes_with_a_file(tmp_path: Path) -> None:
    given = read_given(write_npz(WORLD, tmp_path / "n"))
    before = given.state
    assert read_given(tmp_path / "n").state == before
    (file, *_) = given.files()
    np.savez(file, points1=POINT, points2=POINT)
    assert given.state != before


def test_the_size_of_an_image(tmp_path: Path) -> None:
    """As the source states it, or by the principal point of K."""
    given = read_given(write_hloc(WORLD, tmp_path / "h"))
    assert given.header(tmp_path / "none", PAIR[0], None) == Header("", IMAGE)
    given = read_given(write_hloc(WORLD, tmp_path / "o", sizes=False))
    assert given.header(tmp_path / "none", PAIR[0], CAMERA).size == IMAGE
    with pytest.raises(
        InputError, match="has no camera, and .* states no size of it: give K or images"
    ):
        given.header(tmp_path / "none", PAIR[0], None)


def _without(table: str, path: Path) -> Path:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(f"DROP TABLE {table}")
    return path


def _without_matches(path: Path) -> Path:
    write_with_pycolmap(WORLD, path)
    with pycolmap.Database.open(path) as database:
        database.clear_matches()
    return path


def _text(path: Path) -> Path:
    path.write_text("name1 name2\n" * 100)
    return path


def _empty(path: Path) -> Path:
    path.mkdir()
    return path


def _features_alone(path: Path) -> Path:
    write_hloc(WORLD, path)
    (path / "feats-any_matches-any.h5").unlink()
    return path


def _other_features(path: Path) -> Path:
    write_hloc(WORLD, path)
    with h5py.File(path / "feats-any.h5", "r+") as file:
        file.move("rows", "columns")
    return path


@pytest.mark.parametrize(
    ("write", "reason"),
    [
        (_text, "cannot be read as a COLMAP database (file is not a database"),
        (
            lambda path: _without("keypoints", write_with_pycolmap(WORLD, path)),
            "no such table: keypoints",
        ),
        (lambda path: _without("two_view_geometries", _without_matches(path)), "no such table"),
        (_without_matches, "cannot be read as a COLMAP database (it has no matches)"),
        (_empty, "holds neither hloc's .h5 nor an .npz"),
        (lambda path: _npz(path / "one.npz"), "one.npz has no arrays image1 and image2, and its"),
        (_features_alone, "needs one .h5 with matches0, and no file has it"),
        (_other_features, "has no pair of images of feats-any.h5 (first: rows-photo 0.jpg/"),
    ],
)
def test_a_path_that_is_no_source_is_refused(tmp_path: Path, write, reason: str) -> None:
    path = write(tmp_path / "source")
    with pytest.raises(InputError) as caught:
        read_given(path)
    assert reason in str(caught.value) and str(path) in str(caught.value)
