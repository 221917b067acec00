"""True cameras from lists and folders, and reconstructions and locations scored against them."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from batch_runs import view_folder
from command_line import assert_refused, run
from scipy.spatial.transform import Rotation
from worlds import SIZE, K, View, render_views, write_views

from dgc_pose.batch.pairs import PairRow, row_of
from dgc_pose.benchmarks.models import (
    location_report,
    model_figures,
    pair_figures,
    thinned,
    true_model,
    views_of_list,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair, write_pairs
from dgc_pose.errors import ImageError, InputError
from dgc_pose.estimation import RelativePose
from dgc_pose.model import Model


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, list[View]]:
    """A folder of four views, and a list that connects them 0-1, 2-1, 2-3."""
    folder = tmp_path_factory.mktemp("scene") / "photos"
    views = view_folder(folder, 4)
    pairs = []
    for i, j in ((0, 1), (2, 1), (2, 3)):
        R = views[j].R @ views[i].R.T
        t = views[j].t - R @ views[i].t
        names = (f"photos/view{i}.png", f"photos/view{j}.png")
        pairs.append(Pair(*names, folder.parent, Camera(K), Camera(K), R, t))
    path = folder.parent / "pairs.txt"
    write_pairs(path, pairs)
    return folder, path, views


def test_a_model_with_an_image_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    """Figures over fewer images would not be those of the scene."""
    names = write_views(tmp_path / "images", render_views(4))
    rows = [f"{name},1,0,0,0,0,0,0,{K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}" for name in names]
    table = tmp_path / "poses.csv"
    table.write_text("\n".join(["name,qw,qx,qy,qz,tx,ty,tz,fx,fy,cx,cy", *rows]))
    assert len(true_model(table, tmp_path / "images").poses) == 4
    (tmp_path / "images" / names[2]).write_bytes(b"")
    with pytest.raises(ImageError, match=rf"{names[2]} is empty"):
        true_model(table, tmp_path / "images")


def _relative(poses: dict[str, np.ndarray], a: str, b: str) -> np.ndarray:
    square = [np.vstack([poses[name], [0, 0, 0, 1]]) for name in (a, b)]
    relative: np.ndarray = square[1] @ np.linalg.inv(square[0])
    return relative


def test_a_list_is_chained(scene: tuple[Path, Path, list[View]]) -> None:
    folder, path, views = scene
    found = views_of_list(path, folder)
    assert sorted(found.poses) == [f"view{i}.png" for i in range(4)]
    true = {f"view{i}.png": np.column_stack([v.R, v.t]) for i, v in enumerate(views)}
    ends = "view0.png", "view3.png"
    np.testing.assert_allclose(_relative(dict(found.poses), *ends), _relative(true, *ends))
    assert found.cameras["view0.png"].size == SIZE
    lines = path.read_text().splitlines()
    (folder.parent / "broken.txt").write_text("\n".join([lines[0], lines[2]]))
    with pytest.raises(InputError, match="do not connect"):
        views_of_list(folder.parent / "broken.txt", folder)
    with pytest.raises(InputError, match="not an image of the folder"):
        views_of_list(path, folder / "other")


def _model(views: Model, error: float) -> Model:
    """The true model in other axes and units, with one camera moved by `error` true units."""
    turn = Rotation.from_rotvec([0.3, 0.2, -1]).as_matrix()
    poses = {}
    for i, (name, pose) in enumerate(views.poses.items()):
        centre = 0.2 * turn @ (views.centre(name) + np.array([0, error if i == 1 else 0, 0])) + 5
        R = pose[:, :3] @ turn.T
        poses[name] = np.column_stack([R, -R @ centre])
    cameras = dict(views.cameras)  # one is 2 % off
    *_, last = cameras
    cameras[last] = cameras[last].with_focal(0.98 * cameras[last].focal)
    return Model(views.root, cameras, poses, np.zeros((7, 3)), np.zeros((7, 3), np.uint8))


def test_figures_do_not_depend_on_axes_and_units(scene: tuple[Path, Path, list[View]]) -> None:
    views = views_of_list(scene[1], scene[0])
    exact = model_figures(_model(views, 0), views)
    assert (exact["registered"], exact["points"]) == (4, 7)
    np.testing.assert_allclose(exact["focal_percent"], 2 / 4)
    assert exact["position_rms"] < 1e-9 and exact["rotation_median_deg"] < 1e-6
    moved = model_figures(_model(views, 0.1), views)
    assert 0.02 < moved["position_rms"] < 0.05  # 0.1 in one of four, and the fit takes a part
    length = np.linalg.norm(views.centre("view3.png") - views.centre("view0.png"))
    np.testing.assert_allclose(moved["position_percent"], 100 * moved["position_rms"] / length)
    model = _model(views, 0)
    few = replace(model, poses=dict(list(model.poses.items())[:2]))
    assert "position_rms" not in model_figures(few, views)


def test_the_pairs_of_a_batch_are_scored(scene: tuple[Path, Path, list[View]]) -> None:
    views = views_of_list(scene[1], scene[0])
    rows = []
    for number in (1, 2, 3):
        names = ("view0.png", f"view{number}.png")
        relative = _relative(dict(views.poses), *names)
        turn = Rotation.from_rotvec([0, np.radians(number - 1), 0]).as_matrix()
        R = turn @ relative[:3, :3]
        t = relative[:3, 3]
        pose = RelativePose("ok", "", np.ones(9, bool), 9, R, -t if number < 2 else t)
        rows.append(row_of(names, pose, 1.0))
    rows.append(PairRow("view1.png", "view2.png", "bad_input", ""))
    figures = pair_figures(SimpleNamespace(rows=rows, summary={"pairs": 4, "poses": 3}), views)
    assert (figures["pairs"], figures["poses"]) == (4, 3)
    # Errors 0 (t folded), 1, 2 and infinite: the recall is 1/4 at 0, then 2/4, 3/4, and stays.
    area = 0.25 * 0 + (0.25 + 0.5) / 2 + (0.5 + 0.75) / 2 + 3 * 0.75
    np.testing.assert_allclose(figures["pair_auc5"], 100 * area / 5, atol=0.01)


def test_the_command_scores_reconstructions(
    scene: tuple[Path, Path, list[View]], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    options = ("--methods", "sift,colmap-sift", "--workers", 1, "--runs", 1, "--iterations", 300)
    done = run("bench-model", scene[1], "--images", scene[0], "--out", out, *options)
    assert done.exit_code == 0, done.output
    summary = json.loads((out / "summary.json").read_text())["methods"]
    assert [one["method"] for one in summary] == ["sift", "colmap-sift"]
    for one in summary:
        assert one["registered"] == 4 and one["position_percent"] < 2
        assert one["focal_percent"] < 1e-9
    assert "track length" in done.output


@pytest.fixture(scope="module")
def posed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[View]]:
    """A folder of posed RGB-D images whose depths are unknown."""
    folder = tmp_path_factory.mktemp("rgbd")
    views = render_views(3, step=0.5)
    write_views(folder / "images", views)
    (folder / "depth").mkdir()
    for i in range(len(views)):
        cv2.imwrite(str(folder / f"depth/view{i}.png"), np.zeros((48, 64), np.uint16))
    np.savetxt(folder / "K.txt", K)
    square = [np.vstack([np.column_stack([v.R, v.t]), [0, 0, 0, 1]]) for v in views]
    np.savetxt(folder / "poses.txt", np.stack([np.linalg.inv(s).ravel() for s in square]))
    return folder, views


def test_a_report_counts_what_is_within_bounds() -> None:
    names = "status probability database_images seconds pair_seconds rotation_deg position "
    names += "position_percent rotation_error_90_deg position_error_90"
    rows = (
        ("located", 0.99, 3, 2.0, 1.0, 0.1, 0.02, 0.1, 0.2, 0.01),
        ("located", 0.95, 3, 4.0, 2.0, 30.0, 2.0, 20.0, 1.0, 0.1),
        ("nowhere", 0.0, 5, 1.0, 1.0, *(5 * [np.nan])),
    )
    lines = dict(location_report([dict(zip(names.split(), row, strict=True)) for row in rows]))
    assert lines["located"] == "2 of 3"
    assert lines["right: within 5 deg and 5 % of the extent"] == "1 of 3"
    assert thinned("abcdefg", 3) == ["a", "d", "g"] and thinned(["b", "c"], None) == ["b", "c"]
    assert lines["within 2 deg and 0.05 of the unit"] == "1 of 3"
    assert lines["R within its expected error"] == "1 of 2"
    assert lines["position within its expected error"] == "0 of 2"
    assert lines["right of those at 0.9 or more"] == "1 of 2"
    assert lines["right of those at 0.99 or more"] == "1 of 1"
    assert lines["seconds, median"] == lines["seconds over pair seconds, median"] == "2"


def test_the_command_scores_views(posed: tuple[Path, list[View]], tmp_path: Path) -> None:
    fast = ("--effort", "fast", "--runs", "2", "--iterations", "200", "--count", 1)
    result = run("bench-model", posed[0], "--locate", *fast, "--out", tmp_path / "run")
    assert result.exit_code == 0, result.output
    (network,) = json.loads((tmp_path / "run/summary.json").read_text())["methods"]
    assert [score["name"] for score in network["queries"]] == ["view0.png"]
    assert "located" in result.stdout and "right of those at 0.5 or more" in result.stdout
    other = tmp_path / "other"
    other.mkdir()
    words = ("bench-model", posed[0], "--other", other, "--out", tmp_path / "other_run")
    assert_refused(run(*words), "--other", "holds no images")
    noise = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    picture = cv2.resize(noise, (240, 180), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(other / "a.png"), picture)
    placed = run(*words, *fast)
    assert "0 of 1 placed above 0.5" in placed.stdout
