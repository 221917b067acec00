import dataclasses
import json

import numpy as np
import pytest
from command_line import assert_refused, run
from good_evidence import GOOD_EVIDENCE
from photos import write_photos

from dgc_pose.benchmarks import verdict_pairs
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import load_passes, parse_methods
from dgc_pose.benchmarks.posed_pairs import PosedPair, Truth
from dgc_pose.benchmarks.scoring import evidence_text
from dgc_pose.benchmarks.verdicts import (
    VerdictScore,
    choose_gates,
    coverage,
    gates_table,
    groups_table,
    rates,
    succeeds,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import VerdictOptions
from dgc_pose.images.image import Image
from dgc_pose.synthesis.render.scene_pair import render_scene_pair

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
    evidence_json=evidence_text(GOOD_EVIDENCE),
)


def with_cells(kind, cells, name="a"):
    evidence = evidence_text(dataclasses.replace(GOOD_EVIDENCE, occupied_cells=cells))
    success = cells >= VerdictOptions().min_occupied_cells
    status = "ok" if success else "chance_inliers"
    return dataclasses.replace(
        GOOD, name=name, kind=kind, evidence_json=evidence, success=success, status=status
    )


def test_the_evidence_reads_back():
    read, given = GOOD.evidence, GOOD_EVIDENCE
    assert np.array_equal(read.rotation, given.rotation)
    assert {**vars(read), "rotation": 0} == {**vars(given), "rotation": 0}
    assert dataclasses.replace(GOOD, evidence_json=evidence_text(None)).evidence is None
    assert json.loads(GOOD.evidence_json)["occupied_cells"] == 80


def test_other_gates_are_tried_on_the_evidence_kept():
    least = VerdictOptions().min_occupied_cells
    assert succeeds(with_cells("true", least), VerdictOptions())
    assert not succeeds(with_cells("true", least - 1), VerdictOptions())
    assert succeeds(with_cells("true", least - 1), VerdictOptions(min_occupied_cells=least - 1))
    assert not succeeds(dataclasses.replace(GOOD, evidence_json=""), VerdictOptions())


def test_the_rates_count_unrelated_successes_and_true_failures_and_no_rotations_alone():
    least = VerdictOptions().min_occupied_cells
    judged = [
        with_cells("unrelated", least),
        *[with_cells("unrelated", 3)] * 3,
        with_cells("true", 3),
        with_cells("true", least),
        with_cells("rotation only", least),
        with_cells("rotation only", 3),
    ]
    assert rates(judged, VerdictOptions()) == (0.25, 0.5)


def test_gates_are_chosen_that_part_the_kinds_and_the_defaults_where_they_do():
    easy = [with_cells("unrelated", 3), with_cells("true", 70)]
    assert choose_gates(easy) == VerdictOptions()
    hard = [with_cells("unrelated", places) for places in (5, 27, 29)]
    hard += [with_cells("true", places) for places in (31, 50, 70)]
    chosen = choose_gates(hard)
    assert 29 < chosen.min_occupied_cells <= 31
    assert rates(hard, chosen) == (0, 0)
    with pytest.raises(InputError, match="unrelated and true"):
        choose_gates([with_cells("true", 50)])


def test_the_gates_chosen_on_one_half_are_reported_on_the_other():
    names = [f"pair {k}" for k in range(40)]
    halves = [dataclasses.replace(GOOD, name=name).chooses for name in names]
    assert 10 < sum(halves) < 30
    # Where the gates are chosen they part the kinds; on the other half they let two through.
    judged = []
    for name, chooses in zip(names, halves, strict=True):
        judged.append(with_cells("unrelated", 27 if chooses else 32, name))
        judged.append(with_cells("true", 33, name))
    text = gates_table(judged)
    lines = text.splitlines()
    assert [line.split()[:2] for line in lines[1:5]] == [
        ["default", "choosing"],
        ["default", "reporting"],
        ["chosen", "choosing"],
        ["chosen", "reporting"],
    ]
    assert lines[1].split()[3:6] == [str(sum(halves)), "100.0", "%"]
    assert lines[3].split()[3:6] == ["0", "0.0", "%"]
    assert lines[5].endswith("min_occupied_cells 30")
    assert gates_table([GOOD]).startswith("no gates")


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
    assert judged.success and judged.evidence is not None
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


def test_the_command_prints_both_tables_and_a_run_cut_short_is_resumed(folder):
    out = folder / "run"
    answer = bench(folder, "--out", out)
    assert answer.exit_code == 0, answer.output
    lines = answer.stdout.splitlines()
    groups = [line.split("  ")[0] for line in lines[1:12]]
    assert groups[:3] == ["other photographs", "other scenes", "rendered, 5 to 40 deg"]
    assert groups[3:7] == ["planar", "rotation only", "forward", "facade"]
    assert groups[7:] == ["roll 90", "roll 180", "4x zoom", "night"]
    assert lines[1].split()[2:4] == ["6", "0"]
    assert lines[13].startswith("gates") and lines[-1].startswith("chosen: ")
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
