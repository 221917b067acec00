import dataclasses

import numpy as np
import pytest
from click.testing import CliRunner
from good_evidence import GOOD_EVIDENCE
from verdict_folder import write_photos

from dgc_pose.benchmarks import verdict_cases, verdicts
from dgc_pose.benchmarks.refinement import Case
from dgc_pose.benchmarks.verdicts import (
    Judged,
    candidates,
    choose_gates,
    coverage,
    gates_table,
    groups_table,
    judge_case,
    main,
    rates,
    succeeds,
)
from dgc_pose.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, VerdictOptions
from dgc_pose.image import Image
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.synthesis.render.scene_pair import render_scene_pair

GOOD = Judged("a", "rendered", "true", "ok", True, 300, GOOD_EVIDENCE, 0.1, 0.2, 0.15, 0.15)


def with_places(kind, places, name="a"):
    evidence = dataclasses.replace(GOOD_EVIDENCE, occupied_cells=places)
    success = places >= VerdictOptions().min_occupied_cells
    status = "ok" if success else "chance_inliers"
    return dataclasses.replace(
        GOOD, name=name, kind=kind, evidence=evidence, success=success, status=status
    )


def test_other_gates_are_tried_on_the_evidence_kept():
    least = VerdictOptions().min_occupied_cells
    assert succeeds(with_places("true", least), VerdictOptions())
    assert not succeeds(with_places("true", least - 1), VerdictOptions())
    assert succeeds(with_places("true", least - 1), VerdictOptions(min_occupied_cells=least - 1))
    assert not succeeds(dataclasses.replace(GOOD, evidence=None), VerdictOptions())


def test_the_rates_count_unrelated_successes_and_true_failures_and_no_mere_turns():
    least = VerdictOptions().min_occupied_cells
    judged = [
        with_places("unrelated", least),
        *[with_places("unrelated", 3)] * 3,
        with_places("true", 3),
        with_places("true", least),
        with_places("turned", least),
        with_places("turned", 3),
    ]
    assert rates(judged, VerdictOptions()) == (0.25, 0.5)


def test_gates_are_chosen_that_part_the_kinds_and_the_defaults_where_they_do():
    assert next(candidates()) == VerdictOptions()
    easy = [with_places("unrelated", 3), with_places("true", 70)]
    assert choose_gates(easy) == VerdictOptions()
    hard = [with_places("unrelated", places) for places in (5, 27, 29)]
    hard += [with_places("true", places) for places in (31, 50, 70)]
    chosen = choose_gates(hard)
    assert 29 < chosen.min_occupied_cells <= 31
    assert rates(hard, chosen) == (0, 0)
    with pytest.raises(InputError, match="unrelated and true"):
        choose_gates([with_places("true", 50)])


def test_the_gates_chosen_on_one_half_are_reported_on_the_other():
    names = [f"pair {k}" for k in range(40)]
    halves = [dataclasses.replace(GOOD, name=name).chooses for name in names]
    assert 10 < sum(halves) < 30
    # Where the gates are chosen they part the kinds; on the other half they let two through.
    judged = []
    for name, chooses in zip(names, halves, strict=True):
        judged.append(with_places("unrelated", 27 if chooses else 32, name))
        judged.append(with_places("true", 33, name))
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


def test_halves_without_pairs_of_both_kinds_are_said_so():
    assert gates_table([GOOD]).startswith("no gates")


def test_a_pose_far_off_is_wrong_and_errors_are_held_against_what_the_pose_said():
    wrong = dataclasses.replace(GOOD, rotation_deg=3.0, translation_deg=11.0)
    failed = dataclasses.replace(
        GOOD,
        status="no_model",
        success=False,
        rotation_deg=np.inf,
        translation_deg=np.inf,
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


def small_case(seed=0):
    pair = render_scene_pair(seed, size1=SIZE, size2=SIZE)
    cameras = Camera(pair.K1, SIZE), Camera(pair.K2, SIZE)
    return Case(Image(pair.image1), Image(pair.image2), *cameras, pair.R, pair.t)


@pytest.fixture
def small_renders(monkeypatch):
    """Small views in place of the large ones textured with photographs."""

    def cases(photos, count, seed):
        return (small_case(seed + k) for k in range(count))

    monkeypatch.setattr(verdict_cases, "rendered_cases", cases)


def test_a_pair_is_judged_with_its_errors():
    case = small_case(3)
    named = verdict_cases.VerdictCase("x", "g", "true", *vars(case).values())
    judged = judge_case(named, SiftMatcher(), EstimationOptions(runs=1))
    assert judged.success and judged.evidence is not None
    assert judged.rotation_deg < 1 and judged.translation_deg < 3
    assert judged.rotation_90_deg > 0
    turned = dataclasses.replace(named, kind="turned", t=None)
    assert np.isnan(judge_case(turned, SiftMatcher(), EstimationOptions(runs=1)).translation_deg)
    stranger = dataclasses.replace(named, kind="unrelated", R=None, t=None)
    assert np.isnan(judge_case(stranger, SiftMatcher(), EstimationOptions(runs=1)).rotation_deg)


def test_the_command_prints_both_tables(tmp_path, small_renders):
    write_photos(tmp_path / "photos", 60)
    for seed, scene in enumerate(("one", "other")):
        write_photos(tmp_path / scene, 3, seed)
    answer = CliRunner().invoke(
        main,
        f"--photos {tmp_path / 'photos'} --scene {tmp_path / 'one'} --scene {tmp_path / 'other'} "
        "--unrelated 6 --unrelated-scenes 2 --pairs 8 --misleading 1 --method sift".split(),
    )
    assert answer.exit_code == 0, answer.output
    lines = answer.stdout.splitlines()
    groups = [line.split("  ")[0] for line in lines[1:12]]
    assert groups == [
        "other photographs",
        "other scenes",
        "rendered, 5 to 40 deg",
        "planar",
        "rotation only",
        "forward",
        "facade",
        "roll 90",
        "roll 180",
        "4x zoom",
        "night",
    ]
    assert lines[1].split()[2:4] == ["6", "0"]
    assert lines[13].startswith("gates") and lines[-1].startswith("chosen: ")


def test_the_command_names_what_it_cannot_use_before_it_starts(tmp_path, monkeypatch):
    def judged_too_early(*arguments):
        raise AssertionError

    monkeypatch.setattr(verdicts, "judge_case", judged_too_early)
    write_photos(tmp_path / "few", 1)
    write_photos(tmp_path / "photos", 60)
    for photos, more, word in (
        ("few", [], "need two"),
        ("photos", ["--list", str(tmp_path / "none.txt")], "none.txt"),
        ("photos", ["--scene", str(tmp_path / "few")], "two scenes"),
        ("photos", ["--method", "nosuch"], "nosuch"),
    ):
        arguments = ["--photos", str(tmp_path / photos), "--method", "sift", *more]
        answer = CliRunner().invoke(main, arguments)
        assert answer.exit_code == 1, word
        assert answer.output.startswith("Error: ") and word in answer.output
