import csv
import json
import os
from dataclasses import replace

import cv2
import dense_scene
import numpy as np
import pytest
from command_line import assert_refused, run

from dgc_pose.errors import WeightsError
from dgc_pose.network.config import DEFAULT_WEIGHTS

FAST = ("--runs", "1", "--iterations", "200", "--refine", "none")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A list of three pairs, pairs.txt; `true`, `off`, `noise` and the default stand for
    networks."""
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pair_list(tmp_path, pairs=3)
    maps = {"true": dense_scene.true_map(), "noise": dense_scene.noise_map()}
    off = dense_scene.true_map(error_px=0.2)
    maps["off"] = replace(off, matchability=np.full_like(off.matchability, 0.1))
    maps[DEFAULT_WEIGHTS] = maps["true"]

    def load(weights):
        if weights not in maps:
            raise WeightsError(f"{weights}: no such weights")
        return maps[weights]

    dense_scene.replace_network(monkeypatch, load)
    return tmp_path


def bench(*arguments):
    return run("bench-pairs", *arguments, *FAST)


def rows_of(run):
    with open(f"{run}/results.csv", newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_table_and_out_hold_the_same_summary(folder):
    result = bench("pairs.txt", "--methods", "true,noise", "--limit", 1, "--out", "run/new")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.splitlines()[-1].split()[:6] == "noise 1 1 - - -".split()
    true, noise = json.loads((folder / "run/new/summary.json").read_text())["methods"]
    assert (true["method"], true["pairs"], true["failures"]) == ("true", 1, 0)
    assert true["median_rotation_deg"] < 0.1 and true["auc5"] > 95
    assert true["median_epipolar_px"] < 0.1
    assert (noise["failures"], noise["median_rotation_deg"], noise["auc20"]) == (1, None, 0)
    files = ["errors.png", "results.csv", "run.jsonl", "summary.json"]
    assert sorted(os.listdir("run/new")) == files
    rows = rows_of("run/new")
    assert [row["method"] for row in rows] == ["true", "noise"]
    assert rows[1]["rotation_error_deg"] == "inf"
    assert cv2.imread("run/new/errors.png").std() > 1


def test_the_first_pairs_of_a_list_that_lies_elsewhere(folder):
    os.makedirs("elsewhere")
    os.rename("pairs.txt", "elsewhere/pairs.txt")
    result = bench("elsewhere/pairs.txt", "--root", ".", "--limit", "1", "--out", "run")
    assert result.exit_code == 0, result.stderr
    assert [row["method"] for row in rows_of("run")] == [DEFAULT_WEIGHTS, "sift"]


def test_the_finished_pairs_are_on_disk_when_a_later_one_fails(folder, monkeypatch):
    calls = iter(range(10))

    original = dense_scene.MapMatcher._match

    def match(self, image1, image2):
        if next(calls) == 2:
            raise RuntimeError("killed")
        return original(self, image1, image2)

    monkeypatch.setattr(dense_scene.MapMatcher, "_match", match)
    result = bench("pairs.txt", "--methods", "true", "--out", "run")
    assert result.exit_code == 1 and "RuntimeError: killed" in result.stderr
    assert os.listdir("run") == ["run.jsonl"]
    assert len((folder / "run/run.jsonl").read_text().splitlines()) == 1 + 2
    monkeypatch.setattr(dense_scene.MapMatcher, "_match", original)
    assert "--resume continues" in bench("pairs.txt", "--methods", "true", "--out", "run").stderr
    result = bench("pairs.txt", "--methods", "true", "--out", "run", "--resume")
    assert result.exit_code == 0 and "2 of 3 pairs are done already" in result.stdout
    assert len(rows_of("run")) == 3


def test_methods_get_other_cameras_and_are_scored_with_the_true_ones(folder):
    rows = []
    for cameras in (), ("--K", "auto:shared"), ("--K-scale", "0.8"):
        run = f"run{len(rows)}"
        result = bench("pairs.txt", "--methods", "true", *cameras, "--limit", "1", "--out", run)
        assert result.exit_code == 0, result.stderr
        has_cameras = "method claimed wrong doubted".split() in [
            line.split()[:4] for line in result.stdout.splitlines()
        ]
        assert has_cameras == bool(cameras)
        rows += rows_of(run)
    known, withheld, wrong = rows
    assert float(known["rotation_error_deg"]) < 0.1 and float(known["focal1_error"]) == 0
    assert known["doubts_camera"] == "False" and float(withheld["focal1_std"]) > 0
    # The wrong K is found by the matches.
    assert wrong["doubts_camera"] == "True" and 0 < float(wrong["focal2_std"]) < 0.05
    assert abs(float(wrong["focal2_error"])) < 0.01 and float(wrong["rotation_error_deg"]) < 0.5


def test_all_is_every_cell_that_leads_into_image_1_trusted_or_not(folder):
    words = ("--methods", "off/all", "--limit", "1", "--max-matches", 10**6, "--out", "run")
    result = bench("pairs.txt", *words)
    assert result.exit_code == 0, result.stderr
    (row,) = rows_of("run")
    places = dense_scene.true_map(error_px=0.2).map
    inside = (places >= -0.5).all(-1) & (places <= np.array(dense_scene.SIZE) - 0.5).all(-1)
    assert int(row["num_matches"]) == inside.sum()
    # Noise of sigma in image 1 is a distance to the line with a median of 0.67 sigma there; that
    # in image 2 is about the same, the views being alike.
    assert float(row["epipolar_all_px"]) == pytest.approx(0.67 * 0.2, rel=0.1)
    assert float(row["epipolar_all_mean_px"]) == pytest.approx(0.8 * 0.2, rel=0.1)


@pytest.mark.parametrize("protocol", ["paper", "native"])
def test_the_maps_of_another_program_give_the_true_poses(folder, protocol):
    """All the way from files to errors: cameras, scales and the direction of the map are right."""
    found = dense_scene.true_map()
    arrays = {name: getattr(found, name)[::2, ::2] for name in ("map", "grid", "matchability")}
    (folder / "maps").mkdir()
    np.savez(folder / "maps/one.png_two.png.npz", **arrays)
    words = ("--methods", "other/all,other", "--matches", "other=maps", "--protocol", protocol)
    result = bench("pairs.txt", *words, "--limit", "1", "--out", "run")
    assert result.exit_code == 0, result.stderr
    every, chosen = rows_of("run")
    for row in (every, chosen):
        assert row["success"] == "True" and float(row["rotation_error_deg"]) < 0.5
        assert float(row["translation_error_deg"]) < 1.5
        assert float(row["epipolar_confident_px"]) < 0.02
    assert int(every["num_matches"]) > int(chosen["num_matches"]) > 1500
    assert (int(chosen["num_matches"]) <= 2000) == (protocol == "native")
    words = (*words[:-1], "native" if protocol == "paper" else "paper")
    again = bench("pairs.txt", *words, "--limit", "1", "--out", "run", "--resume")
    assert_refused(again, "that run has methods")
