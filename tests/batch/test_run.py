"""Batches: results, bad images, resuming after a kill, and unusable input."""

import math
import os
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace

import h5py
import numpy as np
import pycolmap
import pytest
from bad_pictures import BAD_PICTURES, MISSING, write_bad_pictures
from batch_runs import run_sift
from results import ambiguous_pose, exif_camera, pair_row
from worlds import K, K_text

from dgc_pose.batch.pairs import MatchedPair
from dgc_pose.batch.result import Batch, group_name, read_batch, summary_of, write_cameras
from dgc_pose.batch.run import _with_folder_checks
from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.colmap.database import pair_geometries
from dgc_pose.errors import InputError
from dgc_pose.estimation import estimate_pose

COUNT = 4  # images
BROKEN = "view3.png"
FOCAL = float(K[0, 0] + K[1, 1]) / 2


@pytest.fixture(scope="module")
def photos(views, tmp_path_factory):
    """Three views and an image that is cut short."""
    folder = tmp_path_factory.mktemp("photos")
    shutil.copytree(views, folder, dirs_exist_ok=True)
    os.truncate(folder / BROKEN, (folder / BROKEN).stat().st_size // 2)
    return folder


@pytest.fixture(scope="module")
def whole(photos, tmp_path_factory):
    """An uninterrupted batch over all pairs."""
    out = tmp_path_factory.mktemp("whole") / "out"
    run_sift(photos, out)
    return out


def test_a_bad_image_is_reported_and_its_pairs_are_rows(whole):
    batch = read_batch(whole)
    bad = [row for row in batch.rows if BROKEN in (row.name1, row.name2)]
    assert len(bad) == COUNT - 1
    assert {row.status for row in bad} == {"bad_input"}
    assert all(BROKEN in row.reason for row in bad)
    assert list(batch.summary["bad_images"]) == [BROKEN]
    assert batch.summary["bad_pairs"] == COUNT - 1


def test_bad_images_of_a_list_are_named_and_the_others_matched(photos, tmp_path):
    """Each is in the summary and in its row, with the reason; a K of the right size is enough."""
    bad = write_bad_pictures(tmp_path / "bad")
    for name in ("view0.png", "view1.png"):
        (tmp_path / name).write_bytes((photos / name).read_bytes())
    lines = [f"view0.png bad/{path.name}" for path in bad]
    (tmp_path / "list.txt").write_text("\n".join([*lines, "view0.png view1.png"]))
    batch = run_sift(tmp_path / "list.txt", tmp_path / "out", pairs=None)
    *others, last = batch.rows
    assert last.success and len(others) == len(bad)
    for row, (name, reason) in zip(others, BAD_PICTURES.items(), strict=True):
        assert row.status == "bad_input" and reason in row.reason
        assert reason in batch.summary["bad_images"][f"bad/{name}"]
    assert batch.summary["by_status"] == {"bad_input": len(bad), "ok": 1}


def test_bad_images_of_a_folder_are_named(photos, tmp_path):
    """Those that are no images have no pairs."""
    folder = tmp_path / "folder"
    write_bad_pictures(folder)
    for name in ("view0.png", "view1.png"):
        (folder / name).write_bytes((photos / name).read_bytes())
    batch = run_sift(folder, tmp_path / "out")
    bad = batch.summary["bad_images"]
    assert {*bad} == {*BAD_PICTURES} - {MISSING}
    assert all(BAD_PICTURES[name] in reason for name, reason in bad.items())
    assert not {"text.jpg", "empty.jpg"} & {*batch.plan.names} and batch.summary["poses"] == 1


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
    batch = run_sift(photos, tmp_path / "out")
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
    assert not any(row.rejected for row in batch.rows)
    assert batch.summary["judged_together"] == 3 and batch.summary["rejected"] == []
    assert len(pair_geometries(batch)) == 3


def test_pairs_that_are_turned_down_are_told_by_their_groups_and_left_out(whole):
    """view0 is of another place than view1 and view2."""
    batch = read_batch(whole)
    rows = [
        replace(row, folder_probability=0.1 if row.success and "view0.png" in row.names else 0.9)
        for row in batch.rows
        if row.success
    ]
    told = summary_of(batch.plan, rows, [])["rejected"]
    assert told == [{"pairs": 2, "groups": [["view0.png"], ["view1.png", "view2.png"]]}]
    among = [replace(row, folder_probability=0.1 + 0.8 * (k < 2)) for k, row in enumerate(rows)]
    told = summary_of(batch.plan, among, [])["rejected"]
    assert told == [{"pairs": 1, "groups": [["view0.png", "view1.png", "view2.png"]]}]
    probabilities = {row.names: row.folder_probability for row in rows}
    pairs = [
        replace(pair, row=replace(pair.row, folder_probability=probabilities.get(pair.row.names)))
        for pair in batch.pairs()
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Batch, "pairs", lambda _: iter(pairs))
        assert [pair.row.names for pair in pair_geometries(batch)] == [("view1.png", "view2.png")]


def test_a_database_and_a_list_as_source(photos, whole, tmp_path):
    """Its pairs, in their order, with the camera that it holds; it is left as it is."""
    database = tmp_path / "a.db"
    fx, fy, cx, cy = map(float, K_text().split(","))
    with pycolmap.Database.open(database) as open_database:
        parameters = [fx, fy, cx + 0.5, cy + 0.5]
        camera = pycolmap.Camera(model="PINHOLE", width=240, height=180, params=parameters)
        camera.has_prior_focal_length = True
        number = open_database.write_camera(camera)
        for name in ("view0.png", "view1.png", "view2.png"):
            open_database.write_image(pycolmap.Image(name=name, camera_id=number))
        for pair in ((1, 2), (2, 3)):
            open_database.write_matches(*pair, np.zeros((1, 2), np.uint32))
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA user_version = 3800")  # of COLMAP 3.8: an opening changes it
    before = database.read_bytes()
    rows = run_sift(database, tmp_path / "out", pairs=None, K=None, root=photos).rows
    names = [("view0.png", "view1.png"), ("view1.png", "view2.png")]
    assert [row.names for row in rows] == names and database.read_bytes() == before
    by_names = {row.names: row.pose for row in read_batch(whole).rows}
    for row in rows:
        assert row.pose is not None
        np.testing.assert_array_equal(row.pose.cam2_from_cam1, by_names[row.names].cam2_from_cam1)


def test_unusable_input(photos, whole, tmp_path):
    database = tmp_path / "no.db"
    database.write_bytes(b"SQLite format 3\0" + b"\0" * 200)
    alike = tmp_path / "alike.txt"
    alike.write_text("a/view.png a-view.png\na/view.png view1.png\n")
    (tmp_path / "view1.png").write_bytes((photos / "view1.png").read_bytes())
    for source, out, reason in (
        (tmp_path / "none", "out", "is not a folder, video"),
        (database, "out", "cannot be read as a COLMAP database"),
        (alike, "out", "^a-view.png view1.png and a/view.png view1.png have one name in matches"),
        (photos, str(whole), "has a batch already"),
        (photos, str(tmp_path), "not a batch folder of this version"),
    ):
        with pytest.raises(InputError, match=reason):
            run_sift(source, tmp_path / out)
    with pytest.raises(InputError, match="sift cannot choose pairs"):
        run_sift(photos, tmp_path / "out", pairs="auto:2")
    assert not (tmp_path / "out").exists()


def _judged(alone, rows):
    return [pair.row for pair in _with_folder_checks(map(MatchedPair, rows), alone)]


def test_a_photograph_that_most_pairs_show_as_mirrored_has_no_pose_with_others():
    """m: mirrored in two pairs of three. The others have more poses."""
    alone = [
        pair_row("am", "mirrored"),
        pair_row("bm", "mirrored"),
        pair_row("cm"),
        *(pair_row(pair) for pair in ("ab", "ac", "bc")),
    ]
    results = _judged(alone, alone)
    assert [row.status for row in results] == ["mirrored"] * 3 + ["ok"] * 3
    told = results[2]
    assert told.pose is not None and told.pose.R is None and "m" in told.reason
    assert (told.num_matches, told.num_inliers, results[3].num_inliers) == (9, 0, 9)


def test_photographs_that_are_all_mirrored_keep_the_poses_between_them():
    rows = [
        pair_row("ac", "mirrored"),
        pair_row("ad", "mirrored"),
        pair_row("cd"),
    ]
    rows += [
        pair_row("bc", "mirrored"),
        pair_row("bd", "mirrored"),
        pair_row("ab"),
    ]
    assert _judged(rows, rows) == rows


def test_inliers_that_the_cameras_of_the_folder_lose_are_told():
    alone = [pair_row("ab"), pair_row("bc"), pair_row("cd", "improbable", inliers=9)]
    rows = [pair_row("ab", inliers=4), pair_row("bc", inliers=5), pair_row("cd", inliers=1)]
    lost, kept, refused = _judged(alone, rows)
    assert lost.pose is not None
    assert lost.pose.warnings == ("only 4 of 9 inliers remain with the folder's cameras",)
    assert kept == rows[1] and refused == rows[2]


def test_the_cameras_are_read_back(tmp_path):
    camera = exif_camera()
    lens = Distortion("OPENCV", (-0.3, 0.1, 1e-3, 0.0))
    cameras = {
        'a "1", 2.png': camera,
        "b/c.png": replace(camera, identity=None, focal_std=1 / 3),
        "d.png": replace(camera, distortion=lens, lens_std=0.0),
    }
    write_cameras(tmp_path, cameras)
    again = read_calibration(str(tmp_path / "cameras.csv")).by_name
    assert list(again) == list(cameras)
    for name, camera in cameras.items():
        np.testing.assert_array_equal(again[name].K, camera.K)
        same = {"K": None, "focal_source": None}  # the file has no source
        assert vars(again[name]) | same == vars(camera) | same


def test_a_folder_has_one_camera(views, tmp_path):
    batch = read_batch(run_sift(views, tmp_path / "out", K="auto").folder)
    (camera,) = batch.summary["cameras"]
    assert (camera["images"], camera["pairs"]) == (COUNT, COUNT * (COUNT - 1) // 2)
    assert camera["focal_px"] == pytest.approx(FOCAL, rel=0.01)
    assert 0.002 < camera["focal_std"] < 0.025 and camera["focal_source"] == "matches"
    for name, final in batch.plan.final_cameras.items():
        assert final.focal == camera["focal_px"] and final.focal_std == camera["focal_std"]
        before = batch.plan.cameras[name]
        assert before.focal_source in ("size", "lines")
        assert final.focal_std < before.focal_std
        assert abs(math.log(before.focal / FOCAL)) < 3 * before.focal_std
    for row in batch.rows:
        for used in (row.pose.camera1, row.pose.camera2):
            assert (used.focal, used.focal_std) == (camera["focal_px"], camera["focal_std"])
