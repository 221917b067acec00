import csv
import json
import os

import cv2
import homography_scene as scene
import numpy as np
import pytest
import torch
from command_line import assert_refused, run
from map_nets import MapNet

from dgc_pose.benchmarks.maps import true_map
from dgc_pose.errors import WeightsError
from dgc_pose.geometry.pixels import pixel_grid

FILES = ["pairs.csv", "pck.png", "summary.json"]


@pytest.fixture
def planes(tmp_path, monkeypatch):
    """A sequence of HPatches. `true` says the plane's map, `still` that nothing moved, without a
    mask."""
    monkeypatch.chdir(tmp_path)
    scene.write_sequence(tmp_path / "planes" / "v_adam")
    truth, valid = true_map(scene.H, scene.SIZE1, scene.SIZE2)
    still = torch.from_numpy(pixel_grid((240, 240)))
    sure = torch.from_numpy(np.where(valid, 0.99, 0.01))
    nets = {
        "true": MapNet(torch.from_numpy(truth), sure),
        "still": MapNet(still),
        "half": MapNet(still, torch.where(torch.arange(240) < 120, 0.9, 0.1).expand(240, 240)),
    }

    def load_network(weights, device):
        if weights not in nets:
            raise WeightsError(f"{weights}: no such weights")
        return nets[weights]

    monkeypatch.setattr("dgc_pose.benchmarks.maps.load_network", load_network)
    return tmp_path


def lines(result, *start):
    """The fields of the lines that begin so."""
    words = (own.split() for own in result.stdout.splitlines())
    return [own for own in words if own[: len(start)] == [*start]]


def still_aepe():
    """The error of "nothing moved", by the truth alone."""
    truth, valid = true_map(scene.H, scene.SIZE1, scene.SIZE2)
    y, x = np.nonzero(valid)
    return np.mean(np.hypot(truth[y, x, 0] - x, truth[y, x, 1] - y))


def test_planes_have_a_line_a_viewpoint_and_method_and_out_has_every_figure(planes):
    words = ("--homographies", "planes", "--methods", "true,still,half,dis", "--out", "run/new")
    result = run("bench-maps", *words)
    assert (result.exit_code, result.stderr) == (0, "")
    assert "1 of HPatches' 59 sequences" in result.stdout
    (true,), (still,) = lines(result, "III", "true"), lines(result, "III", "still")
    assert true[2:4] == ["1", "0.00"] and true[-2] == "1.000"
    assert still[3] == f"{still_aepe():.2f}" and still[-2:] == ["-", "-"]
    data = json.loads((planes / "run/new/summary.json").read_text())
    assert data["sequences"] == 1
    true, still, half, dis = data["methods"]
    assert true["all"]["pairs"] == 5 and true["all"]["aepe"] < 1e-3
    # Coarse levels are the means of cells, which a homography does not quite keep.
    assert true["all"]["aepe15"] < 0.2
    assert [group["group"] for group in half["groups"]] == ["I", "II", "III", "IV", "V"]
    assert half["groups"][0]["aepe"] == pytest.approx(still_aepe(), rel=1e-4)
    assert true["reliability"]["share_correct"][9] == 1
    assert sum(half["reliability"]["counts"]) == 5 * 240 * 240 and still["reliability"] is None
    assert len(data["pck_thresholds_px"]) == len(still["all"]["pck"]) == 200
    (line,) = (own for own in result.stdout.splitlines() if own.startswith("true: "))
    assert "percent within 3 px by tenths of matchability: " in line
    figures = dis["all"]
    assert figures["aepe"] == figures["aepe240"] < 0.5 * still["all"]["aepe"]
    assert figures["aepe15"] is None and 0.3 < figures["jaccard"] <= 1
    assert sorted(os.listdir("run/new")) == FILES
    with open("run/new/pairs.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 20 and rows[0]["pair"] == "v_adam 1-2"
    assert cv2.imread("run/new/pck.png").std() > 1


def test_unusable_input_is_one_line_and_writes_nothing(planes):
    for words in (("--methods", "true,nosuch"), ("--methods", "sift"), ("--methods", ",")):
        assert_refused(run("bench-maps", "--homographies", "planes", *words))
    assert_refused(run("bench-maps", "--homographies", "."), "no pairs")
    assert os.listdir(planes) == ["planes"]
