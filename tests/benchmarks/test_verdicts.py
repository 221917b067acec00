import dataclasses

import numpy as np
import pytest
from command_line import assert_refused, run
from photos import write_photos

from dgc_pose.benchmarks import verdict_pairs
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import load_passes, parse_methods
from dgc_pose.benchmarks.posed_pairs import PosedPair, Truth
from dgc_pose.benchmarks.verdicts import VerdictScore, coverage, groups_table
from dgc_pose.cameras.camera import Camera
from dgc_pose.images.image import Image
from dgc_pose.training.synthesis.render.scene_pair import render_scene_pair

GOOD = VerdictScore(
    method="net",
    true_rotation_deg=10.0,
    status="ok",
    success=True,
    num_matches=500,
    num_inliers=300,
    inlier_ratio=0.6,
    rotation_error_deg=0.1,
    translation_error_deg=0.2,
    translation_folded_deg=0.2,
    match_seconds=0.1,
    estimate_seconds=0.1,
    name="a",
    group="rendered",
    kind="true",
    rotation_90_deg=0.15,
    translation_90_deg=0.15,
)


def test_a_pose_far_off_is_wrong_and_errors_are_held_against_what_the_pose_said():
    wrong = dataclasses.replace(GOOD, rotation_error_deg=3.0, translation_error_deg=11.0)
    failed = dataclasses.replace(
        GOOD,
        status="no_model",
        success=False,
        rotation_error_deg=np.inf,
        translation_error_deg=np.inf,
        rotation_90_deg=np.nan,
        translation_90_deg=np.nan,
    )
    assert wrong.far_off and not GOOD.far_off and not failed.far_off
    assert coverage([GOOD, wrong, failed]) == ("1 of 2", "0 of 2")
    stranger = dataclasses.replace(failed, kind="unrelated", group="strangers")
    assert coverage([stranger]) == ("-", "-")
    lines = groups_table([GOOD, wrong, failed, stranger]).splitlines()
    assert lines[1].split()[1:5] == ["3", "2", "1", "1"]
    assert lines[2].split()[1:5] == ["1", "0", "-", "1"]


SIZE = (320, 240)


def small_pair(seed=0):
    pair = render_scene_pair(seed, size1=SIZE, size2=SIZE)
    truth = Truth({}, Camera(pair.K1, SIZE), Camera(pair.K2, SIZE), pair.R, pair.t)
    return PosedPair(truth, Image(pair.image1), Image(pair.image2))


@pytest.fixture
def small_renders(monkeypatch):
    """Small views in place of the large ones textured with photographs."""

    class SmallPairs:
        def __init__(self, photos, count, seed):
            self.read = lambda: map(small_pair, range(seed, seed + count))

    monkeypatch.setattr(verdict_pairs, "RenderedPosedPairs", SmallPairs)


def test_a_pair_is_judged_with_its_errors():
    pair = small_pair(3)
    unknown = {"true": {}, "rotation only": {"t": None}, "unrelated": {"R": None, "t": None}}
    kinds = [*unknown]
    truths = [dataclasses.replace(pair.truth, **values) for values in unknown.values()]
    pairs = [dataclasses.replace(pair, truth=truth) for truth in truths]
    groups = [
        verdict_pairs.Group("g", kind, ["x"], lambda pair=pair: iter([pair]))
        for kind, pair in zip(kinds, pairs, strict=True)
    ]
    methods = parse_methods(["sift:runs=1"])
    passes = load_passes(methods, device="cpu")
    rows = list(Evaluation(verdict_pairs.VerdictPairs(groups), methods, passes).run())
    judged, rotated, stranger = (scored[0].score for scored in rows)
    assert [one.kind for one in (judged, rotated, stranger)] == kinds
    assert judged.success
    assert judged.rotation_error_deg < 1 and judged.translation_error_deg < 3
    assert judged.rotation_90_deg > 0
    assert np.isnan(rotated.translation_error_deg) and rotated.rotation_error_deg < 1
    assert np.isnan(stranger.rotation_error_deg)


def bench(folder, *more):
    return run(
        *("bench-verdicts", "--photos", folder / "photos"),
        *("--scene", folder / "one", "--scene", folder / "other"),
        *"--unrelated 6 --unrelated-scenes 2 --pairs 8 --misleading 1 --method sift".split(),
        *more,
    )


@pytest.fixture
def folder(tmp_path, small_renders):
    write_photos(tmp_path / "photos", 60)
    for seed, scene in enumerate(("one", "other")):
        write_photos(tmp_path / scene, 3, seed)
    return tmp_path


def test_the_command_prints_the_table_and_a_run_cut_short_is_resumed(folder):
    out = folder / "run"
    answer = bench(folder, "--out", out)
    assert answer.exit_code == 0, answer.output
    lines = answer.stdout.splitlines()
    groups = [line.split("  ")[0] for line in lines[1:13]]
    assert groups[:3] == ["other photographs", "other scenes", "rendered, 5 to 40 deg"]
    assert groups[3:7] == ["planar", "rotation only", "forward", "facade"]
    assert groups[7:] == ["roll 90", "roll 180", "4x zoom", "night", "moving object"]
    assert lines[1].split()[2:4] == ["6", "0"]
    table = (out / "results.csv").read_text()
    (out / "results.csv").write_text(table[: len(table) // 2])
    again = bench(folder, "--out", out, "--resume")
    assert again.exit_code == 0, again.output
    assert "pairs are done already" in again.stdout
    assert again.stdout.splitlines()[1:] == lines


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("few",), "need two"),
        (("photos", "--list", "none.txt"), "none.txt"),
        (("photos", "--scene", "few"), "two scenes"),
    ],
)
def test_the_command_names_what_it_cannot_use(tmp_path, monkeypatch, words, reason):
    monkeypatch.chdir(tmp_path)
    write_photos(tmp_path / "few", 1)
    write_photos(tmp_path / "photos", 60)
    assert_refused(run("bench-verdicts", "--method", "sift", "--photos", *words), reason)
