import json
import math
from dataclasses import replace

import numpy as np
import pytest

from dgc_pose.benchmarks.map_report import (
    figures_table,
    groups_table,
    pairs_table,
    reliability_lines,
    report_data,
    summaries,
)
from dgc_pose.benchmarks.map_scores import PairScores
from dgc_pose.benchmarks.reliability import Reliability


def pair(method: str, group: str, name: str, aepe: float, valid: int = 28800) -> PairScores:
    return PairScores(
        method=method,
        group=group,
        name=name,
        valid=valid,
        aepe=aepe,
        level_aepe=(5 * aepe, 4 * aepe, 3 * aepe, 2 * aepe, aepe),
        near=np.full(200, valid // 2),
        within=np.array([valid // 4, valid // 2, valid]),
        jaccard=0.75 if method == "a" else math.nan,
        jaccard_found=0.5 if method == "a" else math.nan,
        reliability=Reliability.of(np.array([0.05, 0.95]), np.array([False, True]))
        if method == "a"
        else None,
    )


@pytest.fixture
def scores() -> dict[str, list[PairScores]]:
    return {
        m: [
            pair(m, "I", "v_x 1-2", f),
            pair(m, "I", "v_y 1-2", 3 * f),
            pair(m, "II", "v_x 1-3", 8 * f),
            pair(m, "", "wall", 100 * f, 57600),
        ]
        for m, f in (("a", 1.0), ("b", 2.0))
    }


def test_one_figure_by_group_beside_published_rows(scores) -> None:
    lines = groups_table(scores, "aepe", 2, {"DGC-Net (paper)": (1.55, 5.53)}).splitlines()
    assert lines[0].split() == ["method", "I", "II", "all"]
    assert lines[1].split() == ["a", "2.00", "8.00", "4.00"]
    assert lines[2].split() == ["b", "4.00", "16.00", "8.00"]
    assert lines[3].split() == ["DGC-Net", "(paper)", "1.55", "5.53", "-"]
    assert groups_table(scores, "jaccard", 3, {}).splitlines()[2].split() == ["b", "-", "-", "-"]


def test_pairs_without_a_group_are_listed(scores) -> None:
    header, *lines = pairs_table(scores).splitlines()
    assert header.split() == ["pair", "valid", "a", "b"]
    assert [line.split() for line in lines] == [["wall", "100", "%", "100.00", "200.00"]]


def test_all_figures_a_line_a_method(scores) -> None:
    header, a, b = figures_table(summaries(scores, "I"), first="viewpoint I").splitlines()
    assert header.split()[:5] == ["viewpoint", "I", "pairs", "AEPE", "AEPE@15"]
    expected = "a 2 2.00 10.00 8.00 6.00 4.00 2.00 25.0 50.0 100.0 0.750 0.500"
    assert a.split() == expected.split()
    assert b.split()[-2:] == ["-", "-"]
    assert summaries(scores)[0].pairs == 4


def test_the_data_are_strict_json_with_every_figure(scores) -> None:
    data = json.loads(json.dumps(report_data(scores), allow_nan=False))
    a, b = data["methods"]
    assert len(data["pck_thresholds_px"]) == len(a["all"]["pck"]) == 200
    assert a["method"] == "a" and a["all"]["aepe"] == 28 and a["all"]["pairs"] == 4
    assert [group["group"] for group in a["groups"]] == ["I", "II"]
    levels = [a["groups"][1][f"aepe{cells}"] for cells in (15, 30, 60, 120, 240)]
    assert levels == [40, 32, 24, 16, 8]
    assert [a["groups"][0][f"pck{limit}"] for limit in (1, 3, 5)] == [0.25, 0.5, 1]
    assert a["reliability"]["counts"] == [4, 0, 0, 0, 0, 0, 0, 0, 0, 4]
    assert a["reliability"]["share_correct"][:2] == [0, None]
    assert b["reliability"] is None and b["all"]["jaccard"] is None
    assert [one["pair"] for one in b["pairs"]] == ["v_x 1-2", "v_y 1-2", "v_x 1-3", "wall"]


def test_the_reliability_on_a_line_for_each_method_with_a_mask(scores) -> None:
    reliability = Reliability.of(np.array([0.05, 0.05, 0.95]), np.array([False, True, True]))
    masked = [replace(scores["a"][0], reliability=reliability)]
    assert reliability_lines({"a": masked, "b": scores["b"]}) == [
        "a: percent within 3 px by tenths of matchability: 50 - - - - - - - - 100; "
        "expected calibration error 31.7 %"
    ]
