"""From rendered photographs to a model, whose cameras are compared with the rendered ones."""

import json
import os
import shutil
import tempfile
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pycolmap
import pytest
from batch_runs import change_result, run_sift, view_folder
from command_line import assert_refused, run
from worlds import K, K_text, View, render_views, write_views

from dgc_pose.batch.pairs import MatchedPair, row_of
from dgc_pose.batch.result import Batch, read_batch
from dgc_pose.colmap.options import MapperName, ReconstructionOptions
from dgc_pose.colmap.reconstruction import NoModelError, adjust, map_database, reconstruct
from dgc_pose.errors import ImageError, InputError
from dgc_pose.estimation import RelativePose
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.model import Model, require_model_folder

COUNT = 4
SIFT = ["--weights", "sift", "--runs", "1", "--iterations", "300", "--workers", "1"]


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[View]]:
    folder = tmp_path_factory.mktemp("reconstruction") / "photos"
    return folder, view_folder(folder, COUNT)


@pytest.fixture(scope="module")
def batch(views: tuple[Path, list[View]]) -> Batch:
    """All pairs by SIFT."""
    return run_sift(views[0], views[0].parent / "batch")


def _assert_true(model: Model, views: list[View], max_deg: float, max_share: float) -> None:
    """All cameras, after a similarity, are where they were rendered; max_share of the extent."""
    names = sorted(model.poses)
    assert names == [f"view{i}.png" for i in range(COUNT)]
    for i, j in combinations(range(COUNT), 2):
        R = model.poses[names[j]][:, :3] @ model.poses[names[i]][:, :3].T
        assert rotation_error_deg(R, views[j].R @ views[i].R.T) < max_deg
    true = np.stack([view.centre for view in views])
    centres = np.stack([model.centre(name) for name in names])
    similarity = pycolmap.estimate_sim3d(centres, true)
    assert similarity is not None
    error = np.linalg.norm([similarity * centre for centre in centres] - true, axis=1)
    assert error.max() < max_share * np.linalg.norm(true[-1] - true[0])


@pytest.mark.parametrize("mapper", ["incremental", "global"])
def test_cameras_are_those_that_rendered_the_views(
    views: tuple[Path, list[View]], batch: Batch, tmp_path: Path, mapper: MapperName
) -> None:
    """And to the bit the same once more."""
    options = ReconstructionOptions(mapper=mapper)
    (model,), _, _ = reconstruct(batch, tmp_path, options)
    _assert_true(model, views[1], 0.05, 0.01)
    assert model.colmap is not None
    assert model.colmap.compute_mean_reprojection_error() < 0.3
    assert model.colmap.compute_mean_track_length() > 3
    lengths = [point.track.length() for point in model.colmap.points3D.values()]
    assert sum(length > 2 for length in lengths) > 200
    assert pycolmap.Reconstruction(tmp_path / "sparse").num_reg_images() == COUNT
    assert (tmp_path / "points.ply").read_bytes().startswith(b"ply")
    (again,), _, _ = reconstruct(batch, tmp_path / "again", options)
    for name, pose in model.poses.items():
        np.testing.assert_array_equal(pose, again.poses[name])
    np.testing.assert_array_equal(model.points, again.points)


def test_the_command_from_folder_to_model(
    views: tuple[Path, list[View]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    arguments = ("reconstruct", views[0], "--out", out, "--K", K_text(), *SIFT)
    result = run(*arguments)
    assert result.exit_code == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["images"] == summary["registered"] == COUNT
    assert summary["pairs"] == 6 and summary["mean_track_length"] > 3
    files = {"database.db", "points.ply", "model.html", "summary.json"}
    assert {path.name for path in out.iterdir()} == {"batch", "sparse", *files}
    assert_refused(run(*arguments), "exists already")
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert f"{COUNT} of {COUNT} images" in run(*arguments, "--resume", "--view").output
    assert opened == [(out / "model.html").resolve().as_uri()]


def test_the_command_without_K(views: tuple[Path, list[View]], tmp_path: Path) -> None:
    """The camera is that of the rendering, also in the summary, and so are the positions."""
    out = tmp_path / "out"
    words = ("--out", out, "--K", "auto", "--pairs", "sequential:2")
    result = run("reconstruct", views[0], *words, *SIFT)
    assert result.exit_code == 0
    (camera,) = json.loads((out / "summary.json").read_text())["cameras"]
    assert (camera["model"], camera["images"]) == ("RADIAL", COUNT)
    assert camera["focal_px"] == pytest.approx(K.diagonal()[:2].mean(), rel=0.02)
    assert f"RADIAL, f = {camera['focal_px']:.1f} px after bundle" in result.output
    model = Model.of_colmap(pycolmap.Reconstruction(out / "sparse"), views[0])
    _assert_true(model, views[1], 0.3, 0.02)


def test_each_scene_of_a_folder_has_a_model(tmp_path: Path) -> None:
    """Of four, of three and of one photograph: the largest model is where one alone is, a second
    run replaces both, and what would write a single model over them does not."""
    out, scenes = tmp_path / "out", tmp_path / "photos"
    for seed, (name, count) in enumerate({"a": 3, "b": 4, "c": 1}.items()):
        write_views(scenes / name, render_views(count, seed=seed))
    near = ("--pairs", "sequential:2")
    arguments = ("reconstruct", scenes, "--out", out, "--K", K_text(), *near, *SIFT)
    small, large = ([f"{name}/view{i}.png" for i in range(n)] for name, n in (("a", 3), ("b", 4)))
    for words in ((), ("--resume",)):
        result = run(*arguments, *words)
        assert result.exit_code == 0, result.output
        assert f"{out / 'sparse'}: 4 of 8 images" in result.stdout
        assert f"{out / 'sparse' / '1'}: 3 of 8 images" in result.stdout
        assert "not registered: c/view0.png: a pose in 0 of its 2 pairs\n" in result.stderr
        summary = json.loads((out / "summary.json").read_text())
        assert summary["not_registered"] == ["c/view0.png"]
        assert [model["images"] for model in summary["models"]] == [large, small]
        for folder, names in (("sparse", large), ("sparse/1", small)):
            written = pycolmap.Reconstruction(out / folder)
            assert sorted(i.name for i in written.images.values() if i.has_pose) == names
    require_model_folder(out / "sparse" / "1")
    with pytest.raises(InputError, match="contains files that are not part of a model"):
        require_model_folder(out / "sparse")


def test_the_command_that_exports(batch: Batch, tmp_path: Path) -> None:
    """To COLMAP, and to hloc's files: with the same matches of key points half a pixel apart."""
    path, hloc = tmp_path / "database.db", tmp_path / "hloc"
    arguments = ("export-colmap", batch.folder, "--database", path)
    assert run(*arguments, "--hloc", hloc).exit_code == 0
    assert_refused(run(*arguments[:2]), "give --database, or --hloc")
    assert_refused(run(*arguments), "--overwrite")
    assert f"{COUNT} images" in run(*arguments, "--overwrite").stdout
    features, matches = (h5py.File(hloc / f"{name}.h5") for name in ("features", "matches"))
    with pycolmap.Database.open(path) as exported, features, matches:
        assert exported.num_images() == COUNT
        assert exported.num_verified_image_pairs() == 6
        ids = {image.name: image.image_id for image in exported.read_all_images()}
        for name, number in ids.items():
            stored = exported.read_keypoints(number)[:, :2]
            np.testing.assert_allclose(features[name]["keypoints"], stored - 0.5, atol=5e-5)
            assert len(features[name]["scores"]) == len(stored)
        lines = (hloc / "pairs.txt").read_text().splitlines()
        assert len(lines) == 6
        for name0, name1 in map(str.split, lines):
            matches0 = np.asarray(matches[f"{name0}/{name1}/matches0"])
            index = np.flatnonzero(matches0 != -1)
            stored = exported.read_matches(ids[name0], ids[name1])
            assert {*zip(index, matches0[index], strict=True)} == {*map(tuple, stored)}


def _without_pose(pair: MatchedPair) -> MatchedPair:
    pose = RelativePose("no_model", "no pose", np.zeros(len(pair.matches), bool), 9)
    return replace(pair, row=row_of(pair.row.names, pose, 0.5, pair.row.index))


def test_nothing_to_reconstruct(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Two images that make no model, and a batch without a pose, as of a background that stands
    still; COLMAP's log is not shown, and no file of it is left."""
    view_folder(tmp_path / "two", 2)
    pair = run_sift(tmp_path / "two", tmp_path / "pair")
    with pytest.raises(NoModelError, match="incremental mapper found no model"):
        reconstruct(pair, tmp_path / "model")
    assert capfd.readouterr() == ("", "")
    assert not list(Path(tempfile.gettempdir()).glob(f".*.log.*.{os.getpid()}"))
    first, second, *_ = render_views(4)
    still = first.pixels.copy()
    still[60:120, 80:160] = second.pixels[60:120, 80:160]
    write_views(tmp_path / "still", [first, View(still, second.R, second.t)])
    pair = run_sift(tmp_path / "still", tmp_path / "none")
    with pytest.raises(InputError, match=r"accepted pose; the first: .* stay at the same pixels"):
        reconstruct(pair, tmp_path / "other")
    assert not (tmp_path / "other" / "sparse").exists()


def test_an_image_that_breaks_during_the_mapping_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view_folder(tmp_path / "photos", 3)
    batch = run_sift(tmp_path / "photos", tmp_path / "batch")

    def broken(*arguments: Any) -> list[Any]:
        found = map_database(*arguments)
        (tmp_path / "photos" / "view1.png").write_bytes(b"")
        return found

    monkeypatch.setattr("dgc_pose.colmap.reconstruction.map_database", broken)
    with pytest.raises(ImageError, match=r"view1\.png is empty"):
        reconstruct(batch, tmp_path / "model")


def test_a_pair_that_shares_no_key_point_is_an_ordinary_pair(batch: Batch, tmp_path: Path) -> None:
    """Of neighbours and the first and the last image. These have a pose, all of their matches are
    lost, and no third image is paired with both: they are left out, and all images register."""
    folder = tmp_path / "batch"
    shutil.copytree(batch.folder, folder)

    def changed(pair: MatchedPair) -> MatchedPair:
        i, j = (int(name[4]) for name in pair.row.names)
        if j - i not in (1, COUNT - 1):
            return _without_pose(pair)
        if j - i == 1 or pair.row.pose is None:
            return pair
        pose = replace(pair.row.pose, inliers=np.zeros_like(pair.row.pose.inliers))
        return replace(pair, row=replace(pair.row, pose=pose))

    change_result(folder, changed)
    (model,), shared, _ = reconstruct(read_batch(folder), tmp_path)
    assert len(model.poses) == COUNT and len(shared.pairs) == COUNT - 1
    with pycolmap.Database.open(tmp_path / "database.db") as database:
        assert database.num_verified_image_pairs() == len(shared.pairs)


def test_the_principal_points_of_some_cameras_are_found() -> None:
    """Those of a third of the images, which were 30 px off; no other camera changes."""
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 3, 4, 200
    model = pycolmap.synthesize_dataset(options)
    true = {key: np.array(camera.params) for key, camera in model.cameras.items()}
    cut = min(model.cameras)
    names = [image.name for image in model.images.values() if image.camera_id == cut]
    params = true[cut].copy()
    params[[-3, -2] if len(params) == 4 else [-2, -1]] += (30.0, -20.0)
    model.cameras[cut].params = params
    adjust(model, [], centres=True)
    np.testing.assert_array_equal(model.cameras[cut].params, params)
    adjust(model, names, centres=True)
    np.testing.assert_allclose(model.cameras[cut].params, true[cut], atol=0.05)
    for key in model.cameras.keys():  # noqa: SIM118, pycolmap's map
        if key != cut:
            np.testing.assert_array_equal(model.cameras[key].params, true[key])
