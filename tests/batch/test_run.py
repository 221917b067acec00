"""Batches: results, bad images, resuming after a kill, and unusable input."""

import sqlite3
from contextlib import closing
from dataclasses import replace

import h5py
import numpy as np
import pycolmap
import pytest
from batch_runs import run_sift, view_folder
from multi_view import K_text
from results import ambiguous_pose

from dgc_pose.batch.result import Batch, group_name, read_batch, summary_of
from dgc_pose.colmap.database import pair_geometries
from dgc_pose.errors import InputError
from dgc_pose.estimation import estimate_pose
from dgc_pose.geometry.rotation import rotation_angle_deg

BROKEN = "broken.png"
COUNT = 4  # images, one of them broken


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Four views and an image that is cut short."""
    folder = tmp_path_factory.mktemp("photos")
    views = view_folder(folder, COUNT - 1)
    whole = (folder / "view0.png").read_bytes()
    (folder / BROKEN).write_bytes(whole[: len(whole) // 2])
    return folder, views


@pytest.fixture(scope="module")
def whole(photos, tmp_path_factory):
    """An uninterrupted batch over all pairs."""
    out = tmp_path_factory.mktemp("whole") / "out"
    run_sift(photos[0], out)
    return out


def test_poses_are_those_of_the_rendered_cameras(photos, whole):
    batch = read_batch(whole)
    assert len(batch.rows) == COUNT * (COUNT - 1) // 2
    for row in batch.rows:
        if BROKEN in (row.name1, row.name2):
            continue
        first, second = (photos[1][int(name[4])] for name in (row.name1, row.name2))
        R = second.R @ first.R.T
        t = second.t - R @ first.t
        pose = row.pose
        assert pose is not None and pose.R is not None and pose.t is not None
        assert rotation_angle_deg(R.T @ pose.R) < 0.2
        assert pose.t @ t / np.linalg.norm(t) > np.cos(np.radians(2))
        assert pose.rotation_error_90_deg is not None and pose.num_inliers > 50


def test_a_bad_image_is_reported_and_its_pairs_are_rows(whole):
    batch = read_batch(whole)
    bad = [row for row in batch.rows if BROKEN in (row.name1, row.name2)]
    assert len(bad) == COUNT - 1
    assert {row.status for row in bad} == {"bad_input"}
    assert all(BROKEN in row.reason for row in bad)
    assert list(batch.summary["bad_images"]) == [BROKEN]
    assert batch.summary["bad_pairs"] == COUNT - 1


def test_matches_lie_in_hlocs_layout(whole):
    """Of each pair, also of bad ones, whose data sets are empty."""
    with h5py.File(whole / "matches.h5") as file:
        for pair in read_batch(whole).pairs():
            row, group = pair.row, file[group_name(*pair.row.names)]
            assert len(pair.matches) >= row.num_matches >= row.num_inliers
            assert np.asarray(group["inliers"]).sum() == row.num_inliers
            np.testing.assert_array_equal(group["keypoints0"], pair.matches.points1)
            assert group["keypoints1"].dtype == group["scores"].dtype == np.float32
    assert group_name("a/b.jpg", "c.jpg") == "a-b.jpg/c.jpg"


def test_an_ambiguous_pair_is_counted_and_has_no_geometry(photos, tmp_path, monkeypatch):
    """Its poses are in the row."""
    first = True

    def some_ambiguous(matches, *others, **more):
        nonlocal first
        if not first:
            return estimate_pose(matches, *others, **more)
        first = False
        return ambiguous_pose(len(matches))

    monkeypatch.setattr("dgc_pose.pose.estimate_pose", some_ambiguous)
    batch = run_sift(photos[0], tmp_path / "out")
    (ambiguous,) = (row for row in batch.rows if row.status == "ambiguous")
    assert ambiguous.pose is not None and len(ambiguous.pose.alternatives) == 2
    assert batch.summary["by_status"] == {"ambiguous": 1, "bad_input": 3, "ok": 2}
    assert batch.summary["poses"] == 2
    exported = [pair.row.names for pair in pair_geometries(batch)]
    assert len(exported) == 2 and (ambiguous.name1, ambiguous.name2) not in exported


def test_the_folder_judges_each_pair_that_has_a_pose(whole):
    """Three views of one place: their poses agree."""
    batch = read_batch(whole)
    for row in batch.rows:
        assert (row.folder_probability is None) == (not row.success)
        assert row.folder_triples == ((1, 0) if row.success else (0, 0))
    assert not any(row.turned_down for row in batch.rows)
    assert batch.summary["judged_together"] == 3 and batch.summary["turned_down"] == []
    assert len(pair_geometries(batch)) == 3


def test_pairs_that_are_turned_down_are_told_by_their_groups_and_left_out(whole):
    """view0 is of another place than view1 and view2."""
    batch = read_batch(whole)
    rows = [
        replace(row, folder_probability=0.1 if row.success and "view0.png" in row.names else 0.9)
        for row in batch.rows
        if row.success
    ]
    told = summary_of(batch.plan, rows, [])["turned_down"]
    assert told == [{"pairs": 2, "groups": [["view0.png"], ["view1.png", "view2.png"]]}]
    among = [replace(row, folder_probability=0.1 + 0.8 * (k < 2)) for k, row in enumerate(rows)]
    told = summary_of(batch.plan, among, [])["turned_down"]
    assert told == [{"pairs": 1, "groups": [["view0.png", "view1.png", "view2.png"]]}]
    beliefs = {row.names: row.folder_probability for row in rows}
    pairs = [
        replace(pair, row=replace(pair.row, folder_probability=beliefs.get(pair.row.names)))
        for pair in batch.pairs()
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Batch, "pairs", lambda _: iter(pairs))
        assert [pair.row.names for pair in pair_geometries(batch)] == [("view1.png", "view2.png")]


def test_a_list_and_a_database_as_source(photos, tmp_path):
    """The pairs of the database, which is left as it is, with the camera that it holds."""
    listed = tmp_path / "list.csv"
    listed.write_text("view0.png,view1.png\nview2.png,view1.png\n")
    database = photos[0].parent / f"{photos[0].name}.db"
    fx, fy, cx, cy = map(float, K_text().split(","))
    with pycolmap.Database.open(database) as open_database:
        camera = pycolmap.Camera(
            model="PINHOLE", width=240, height=180, params=[fx, fy, cx + 0.5, cy + 0.5]
        )
        camera.has_prior_focal_length = True
        number = open_database.write_camera(camera)
        for name in ("view0.png", "view1.png", "view2.png"):
            open_database.write_image(pycolmap.Image(name=name, camera_id=number))
        for pair in ((1, 2), (2, 3)):
            open_database.write_matches(*pair, np.zeros((1, 2), np.uint32))
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA user_version = 3800")  # of COLMAP 3.8: an opening changes it
    before = database.read_bytes()
    by_source = {
        path.suffix: run_sift(path, tmp_path / path.suffix, pairs=None, K=K, root=photos[0]).rows
        for path, K in ((listed, K_text()), (database, None))
    }
    assert [(row.name1, row.name2) for row in by_source[".csv"]] == [
        ("view0.png", "view1.png"),
        ("view2.png", "view1.png"),
    ]
    first, second = by_source[".db"][0].pose, by_source[".csv"][0].pose
    assert first is not None and second is not None
    np.testing.assert_array_equal(first.cam2_from_cam1, second.cam2_from_cam1)
    assert by_source[".db"][1].name1 == "view1.png"
    assert database.read_bytes() == before


def test_unusable_input(photos, whole, tmp_path):
    database = tmp_path / "no.db"
    database.write_bytes(b"SQLite format 3\0" + b"\0" * 200)
    alike = tmp_path / "alike.txt"
    alike.write_text("a/view.png a-view.png\na/view.png view1.png\n")
    (tmp_path / "view1.png").write_bytes((photos[0] / "view1.png").read_bytes())
    for source, out, reason in (
        (tmp_path / "none", "out", "no such folder"),
        (database, "out", "not a COLMAP database"),
        (alike, "out", "^a-view.png view1.png and a/view.png view1.png have one name in matches"),
        (photos[0], str(whole), "holds a batch already"),
        (photos[0], str(tmp_path), "no folder of `dgc-pose batch`"),
    ):
        with pytest.raises(InputError, match=reason):
            run_sift(source, tmp_path / out)
    with pytest.raises(InputError, match="sift has no features of a network"):
        run_sift(photos[0], tmp_path / "out", pairs="auto:2")
    assert not (tmp_path / "out").exists()
