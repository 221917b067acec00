import csv
import json
import os

import cv2
import homography_scene as scene
import numpy as np
import pytest
import torch
from command_line import assert_refused, run
from map_nets import MapNet, half_sure, shifted

from dgc_pose.benchmarks.homographies import true_map
from dgc_pose.errors import WeightsError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two sequences; `true` says the plane's map, `still` that nothing moved, without a mask."""
    monkeypatch.chdir(tmp_path)
    for name in ("v_adam", "v_wall"):
        scene.write_sequence(tmp_path / "data" / name)
    truth, valid = true_map(scene.H, scene.SIZE1, scene.SIZE2)
    sure = torch.from_numpy(np.where(valid, 0.99, 0.01))
    nets = {
        "true": MapNet(torch.from_numpy(truth), sure),
        "still": MapNet(shifted(0, 0)),
        "half": MapNet(shifted(0, 0), half_sure()),
    }

    def load_network(weights, device):
        if weights not in nets:
            raise WeightsError(f"{weights}: no such weights")
        return nets[weights]

    monkeypatch.setattr("dgc_pose.benchmarks.map_run.load_network", load_network)
    return tmp_path


def bench(*arguments):
    return run("bench-hpatches", *arguments)


def line(result, start):
    """The fields of the first line that begins so."""
    return next(own.split() for own in result.stdout.splitlines() if own.startswith(start))


def still_aepe():
    """The error of "nothing moved", by the truth alone."""
    truth, valid = true_map(scene.H, scene.SIZE1, scene.SIZE2)
    y, x = np.nonzero(valid)
    return np.mean(np.hypot(truth[y, x, 0] - x, truth[y, x, 1] - y))


def test_the_table_by_viewpoint_stands_beside_published_rows(folder):
    result = bench("--root", "data", "--methods", "true,still")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    assert "2 of HPatches' 59 sequences" in result.stdout
    assert line(result, "true") == ["true", *["0.00"] * 6]
    assert line(result, "still") == ["still", *[f"{still_aepe():.2f}"] * 6]
    published = line(result, "DGC-Net (paper)")
    assert published == ["DGC-Net", "(paper)", "1.55", "5.53", "8.98", "11.66", "16.70", "-"]
    jaccard = result.stdout.split("Jaccard by viewpoint\n")[1].splitlines()
    assert jaccard[1].split() == ["true", *["1.000"] * 6]
    assert jaccard[2].split() == ["still", *["-"] * 6]
    assert sorted(os.listdir(folder)) == ["data"]


def test_out_holds_the_same_figures_and_the_pictures(folder):
    outputs = ("--out", "run/new", "--json", "s.json")
    result = bench("--root", "data", "--methods", "true,half", *outputs)
    assert result.exit_code == 0, result.output
    data = json.loads((folder / "s.json").read_text())
    assert data == json.loads((folder / "run/new/summary.json").read_text())
    assert (data["sequences"], data["missing"]) == (2, [])
    true, half = data["methods"]
    assert true["all"]["pairs"] == 10 and true["all"]["aepe"] < 1e-3
    # Coarse levels are the means of cells, which a homography does not quite keep.
    assert true["all"]["aepe15"] < 0.2
    assert [group["group"] for group in half["groups"]] == ["I", "II", "III", "IV", "V"]
    assert half["groups"][0]["aepe"] == pytest.approx(still_aepe(), rel=1e-4)
    assert true["reliability"]["share_correct"][9] == 1
    names = ["pairs.csv", "pck.png", "reliability.png", "summary.json"]
    assert sorted(os.listdir("run/new")) == names
    with open("run/new/pairs.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 20 and rows[0]["pair"] == "v_adam 1-2"
    for name in names:
        if name.endswith(".png"):
            assert cv2.imread(f"run/new/{name}").std() > 1


def test_matchers_without_a_network_stand_in_the_same_tables(folder):
    words = ("--methods", "still,dis", "--json", "s.json")
    result = bench("--root", "data", *words)
    assert result.exit_code == 0, result.output
    still, *rivals = json.loads((folder / "s.json").read_text())["methods"]
    for rival in rivals:
        figures = rival["all"]
        assert figures["pairs"] == 10 and figures["aepe"] == figures["aepe240"]
        assert figures["aepe"] < 0.5 * still["all"]["aepe"]
        assert figures["aepe15"] is None and 0.3 < figures["jaccard"] <= 1
        assert line(result, f"{rival['method']} ")[-1] == f"{figures['aepe']:.2f}"


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--root", "data", "--methods", "true,nosuch"), "nosuch"),
        (("--root", "data", "--methods", "true,true"), "twice"),
        (("--root", "data", "--methods", "true,sift"), "sift: has key points alone"),
    ],
)
def test_unusable_input_is_one_line_and_writes_nothing(folder, arguments, words):
    if "--methods" not in arguments:
        arguments = (*arguments, "--methods", "true")
    assert_refused(bench(*arguments), words)
    assert sorted(os.listdir(folder)) == ["data"]


def test_a_broken_image_leaves_no_files(folder):
    (folder / "data" / "v_wall" / "6.ppm").write_bytes(b"P6 no image")
    result = bench("--root", "data", "--methods", "true", "--out", "run", "--json", "s.json")
    assert result.exit_code == 2 and "6.ppm" in result.stderr
    assert os.listdir("run") == [] and not os.path.exists("s.json")
