"""Labels of pairs, and the fit of weights that are known."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from dgc_pose.batch.pairs import MatchedPair, row_of
from dgc_pose.benchmarks.folders import (
    KINDS,
    View,
    fit,
    folder_names,
    has_right_pose,
    shows_one_place,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import RelativePose
from dgc_pose.matches import Matches
from dgc_pose.training.posed_frames import PosedFrame
from dgc_pose.training.views import Cameras, about_axis

SIZE = (64, 48)
FOCAL = 50.0
DEPTH = 4.0
K = torch.tensor([[FOCAL, FOCAL, 31.5, 23.5]])


def _view(x: float, part: str = "A") -> View:
    """A view of a wall from a distance."""
    camera = Cameras.at(K, torch.eye(3)[None], torch.tensor([[x, 0.0, 0.0]]))
    depth = np.full(SIZE[::-1], DEPTH, np.float32)
    return View(np.zeros((*SIZE[::-1], 3), np.uint8), camera, depth, part)


def _pair(points1, points2, R=None, t=(-1.0, 0.0, 0.0), inliers=None) -> MatchedPair:
    matches = Matches(points1, points2, np.ones(len(points1)), 1.0)
    inliers = np.ones(len(points1), bool) if inliers is None else inliers
    R = np.eye(3) if R is None else R
    t = None if t is None else np.array(t)
    pose = RelativePose("ok", "", inliers, len(points1), R, t)
    return MatchedPair(row_of(("a", "b"), pose, 1.0), matches)


def _points(count: int = 40) -> np.ndarray:
    return np.random.default_rng(0).uniform((20, 4), (60, 44), (count, 2))


def test_a_pair_shows_one_place_if_half_of_its_inliers_land():
    points = _points()
    shift = np.array([FOCAL / DEPTH, 0.0])
    is_right = partial(shows_one_place, {"a": _view(0), "b": _view(1)})
    true = points - shift
    elsewhere = points - shift + (12, 0)
    assert is_right(_pair(points, true + (5, 3)))
    assert not is_right(_pair(points, elsewhere))  # as a shelf is, a place further
    for wrong, right in ((18, True), (22, False)):
        some = np.concatenate([elsewhere[:wrong], true[wrong:]])
        assert is_right(_pair(points, some)) == right
        assert is_right(_pair(points, some, inliers=np.arange(40) >= wrong))
    views = {"a": _view(0), "b": _view(1, part="B")}
    assert not shows_one_place(views, _pair(points, true))
    # A point beside an edge has the depth of what is behind in one of the images alone.
    first = _view(0)
    second = _view(1)
    first.depth[:] = 1.5
    assert shows_one_place({"a": first, "b": second}, _pair(points, true))
    second.depth[:] = 1.5
    assert not shows_one_place({"a": first, "b": second}, _pair(points, true))


def _frame(x: float, reach=(2.0, 8.0)) -> PosedFrame:
    pose = np.eye(4)
    pose[0, 3] = -x
    return PosedFrame(Path("a"), Camera(K[0].numpy()), pose, reach=reach)


def test_a_pose_is_right_within_ten_degrees_and_t_counts_with_a_baseline():
    def is_right(baseline, degrees, t) -> bool:
        R = about_axis(torch.tensor(np.radians(degrees)), 1).numpy()
        frames = {"a": _frame(0), "b": _frame(baseline)}
        return has_right_pose(frames, _pair(_points(), _points(), R, t))

    left = (-1.0, 0.0, 0.0)
    up = (0.0, 1.0, 0.0)
    assert is_right(1.0, 9.0, left) and not is_right(1.0, 11.0, left)
    assert not is_right(1.0, 0.0, up) and not is_right(1.0, 0.0, (1.0, 0.0, 0.0))
    assert is_right(0.41, 0.0, left) and not is_right(0.41, 0.0, up)
    assert is_right(0.39, 0.0, up)  # a tenth of 4, the mean of 2 and 8
    assert is_right(1.0, 9.0, None) and not is_right(1.0, 11.0, None)


def _folder(seed: int, count: int = 1500):
    """Pairs that are right by known weights, without triples."""
    rng = np.random.default_rng(seed)
    values = rng.normal(0, (3, 0.1, 1), (count, 3))
    odds = values @ (0.3, 8.0, 0.9) + 0.7
    right = rng.random(count) < 1 / (1 + np.exp(-odds))
    return values, right, np.zeros((0, 3), np.int64), np.zeros(0, bool)


def test_the_fit_finds_the_weights_and_scores_folders_left_out():
    folders = {f"folder{k}": _folder(k) for k in range(4)}
    values, _, *none = _folder(9, 20)
    folders["plain"] = (values, np.ones(20, bool), *none)
    header, *lines, fitted = fit(folders).splitlines()
    headings = "folder pairs wrong AUC of pairs by repeats right rejected wrong kept"
    assert header.split() == headings.split()
    table = {line.split()[0]: line.split()[1:] for line in lines}
    assert set(table) == set(folders) and table["plain"][1:3] == ["0", "-"]
    assert all(0.75 < float(table[f"folder{k}"][2]) < 0.9 for k in range(4))
    found = {"np": np}
    exec(fitted.replace("_WEIGHTS, _INTERCEPT", "weights, intercept"), found)
    np.testing.assert_allclose(found["weights"], (0.3, 8.0, 0.9), rtol=0.15)
    assert found["intercept"] == pytest.approx(0.7, abs=0.15)


def test_parts_of_a_scene_are_judged_and_not_fitted():
    """A part that is its whole scene: weights of the other folders judge both."""
    folders = {f"folder{k}": _folder(k) for k in range(2)}
    *_, fitted = fit(folders).splitlines()
    _, whole, _, part, again = fit({**folders, "folder0/2": folders["folder0"]}).splitlines()
    assert again == fitted
    assert part.split() == ["folder0/2", *whole.split()[1:]]


def test_folders_are_of_each_kind_and_as_many_scenes(tmp_path):
    for number in range(20):
        (tmp_path / "posed" / f"scene{number:02d}" / "images").mkdir(parents=True)
    names = folder_names(tmp_path, 2)
    assert len(names) == 16 and {name[:-2] for name in names[:8]} == {*KINDS}
    assert names[8] == "scene00" and names[-1] == "scene19"
