import json
from dataclasses import replace

import dense_scene
import numpy as np
import pytest
from command_line import run as run_command
from photos import write_photos

from dgc_pose.benchmarks import posed_pairs
from dgc_pose.benchmarks.camera_trial import CameraTrial
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import Method
from dgc_pose.benchmarks.posed_pairs import (
    ListedPairs,
    RenderedPosedPairs,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import Matcher, MatchingOptions, MatchResult
from dgc_pose.metrics import rotation_error_deg

OPTIONS = EstimationOptions(runs=2, iterations=200)


class Backwards(Matcher):
    """The true matches with the images exchanged: a pose that is wrong by a known amount."""

    name = "backwards"

    def _match(self, image1, image2):
        found = dense_scene.MapMatcher(dense_scene.true_map()).match(image1, image2).matches
        return MatchResult(replace(found, points1=found.points2, points2=found.points1), None)


def run(pairs, matchers, options):
    """The records of matchers by name, one by one."""
    unrefined = MatchingOptions(aligned="none")
    methods = [
        Method(name, MatcherOptions(name, matching=unrefined), options, CameraTrial())
        for name in matchers
    ]
    loaded = {method.matcher: matchers[method.name] for method in methods}
    for scores in Evaluation(ListedPairs(pairs), methods, loaded).run():
        yield from scores


@pytest.fixture
def pairs(tmp_path):
    return read_pairs(dense_scene.write_pair_list(tmp_path, pairs=2))


def test_a_wrong_pose_has_its_error(pairs):
    (result,) = run(pairs[:1], {"backwards": Backwards()}, OPTIONS)
    # The pose found is cam1_from_cam2: its rotation is off by twice the true one.
    assert result.success
    assert result.rotation_error_deg == pytest.approx(2 * result.true_rotation_deg, abs=0.1)
    cosine = float(dense_scene.T @ (-dense_scene.R.T @ dense_scene.T))
    assert result.translation_error_deg == pytest.approx(np.degrees(np.arccos(cosine)), abs=0.3)
    folded = min(result.translation_error_deg, 180 - result.translation_error_deg)
    assert result.translation_folded_deg == folded


def test_the_K_of_another_image_is_refused(pairs):
    far = Camera(np.array([[900.0, 0, 800], [0, 900, 600], [0, 0, 1]]))
    with pytest.raises(InputError, match=r"K of .*two\.png"):
        list(run([replace(pairs[0], camera2=far)], {"backwards": Backwards()}, OPTIONS))


@pytest.fixture
def photos(tmp_path, monkeypatch):
    monkeypatch.setattr(posed_pairs, "RENDERED_SIZE", 160)
    write_photos(tmp_path / "photos", 60)
    return tmp_path / "photos"


def test_rendered_pairs_are_the_same_from_any_of_them_on(photos):
    pairs = RenderedPosedPairs(photos, 3, 7)
    whole, rest = list(pairs.read()), list(pairs.read(1))
    assert [one.truth.ids for one in whole] == pairs.ids
    assert [one.truth.ids for one in rest] == pairs.ids[1:]
    for one, again in zip(whole[1:], rest, strict=True):
        assert np.array_equal(one.image2.pixels, again.image2.pixels)
        assert np.array_equal(one.truth.R, again.truth.R)
    for one in whole:
        assert one.image1.size == one.truth.camera1.size == (160, 160)
        assert 5 <= rotation_error_deg(one.truth.R, np.eye(3)) <= 45
        assert np.linalg.norm(one.truth.t) > 0


def test_rendered_pairs_have_their_distances_from_the_epipolar_lines(photos, tmp_path):
    words = ("--rendered", 2, "--photos", photos, "--methods", "dis,sift")
    answer = run_command("bench-pairs", *words, "--json", tmp_path / "s.json")
    assert answer.exit_code == 0, answer.output
    head, *lines = answer.stdout.splitlines()[-3:]
    assert head.split()[-7:] == ["D_e", "all", "D_e", "conf", "matches", "pose", "s"]
    assert [line.split()[0] for line in lines] == ["dis", "sift"]
    dis, sift = json.loads((tmp_path / "s.json").read_text())["methods"]
    assert dis["median_epipolar_px"] > 0 and sift["median_epipolar_px"] is None
