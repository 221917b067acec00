import json
import math

import numpy as np
import pytest

from dgc_pose.benchmarks.map_report import maps_table, reliability_lines, report_data
from dgc_pose.benchmarks.map_scores import MapScore
from dgc_pose.benchmarks.reliability import Reliability


def pair(method: str, group: str, name: str, aepe: float, valid: int = 28800) -> MapScore:
    masked = method == "a"
    return MapScore(
        method=method,
        group=group,
        name=name,
        pairs=1,
        valid=valid,
        aepe=aepe,
        level_aepe=(5 * aepe, 4 * aepe, 3 * aepe, 2 * aepe, aepe),
        near=np.full(200, valid // 2),
        within=np.array([valid // 4, valid // 2, valid]),
        jaccard=0.75 if masked else math.nan,
        jaccard_found=0.5 if masked else math.nan,
        reliability=Reliability.of(np.array([0.05, 0.05, 0.95]), np.array([False, True, True]))
        if masked
        else None,
    )


@pytest.fixture
def scores() -> dict[str, list[MapScore]]:
    return {
        m: [
            pair(m, "I", "v_x 1-2", f),
            pair(m, "I", "v_y 1-2", 3 * f),
            pair(m, "II", "v_x 1-3", 8 * f),
            pair(m, "graf", "wall", 100 * f, 57600),
        ]
        for m, f in (("a", 1.0), ("b", 2.0))
    }


def test_a_line_a_group_and_method_and_over_all_pairs(scores) -> None:
    header, *lines = (line.split() for line in maps_table(scores).splitlines())
    assert header[:5] == ["group", "method", "pairs", "AEPE", "AEPE@15"]
    expected = "I a 2 2.00 10.00 8.00 6.00 4.00 2.00 25.0 50.0 100.0 0.750 0.500"
    assert lines[0] == expected.split()
    assert lines[1][:4] == ["I", "b", "2", "4.00"] and lines[1][-2:] == ["-", "-"]
    starts = [(*line[:2], line[3]) for line in lines[4:]]
    assert starts == [
        *(("graf", "a", "100.00"), ("graf", "b", "200.00")),
        *(("all", "a", "28.00"), ("all", "b", "56.00")),
    ]


def test_the_data_are_strict_json_with_every_figure(scores) -> None:
    data = json.loads(json.dumps(report_data(scores), allow_nan=False))
    a, b = data["methods"]
    assert len(data["pck_thresholds_px"]) == len(a["all"]["pck"]) == 200
    assert a["method"] == "a" and a["all"]["aepe"] == 28 and a["all"]["pairs"] == 4
    assert [group["group"] for group in a["groups"]] == ["I", "II", "graf"]
    levels = [a["groups"][1][f"aepe{cells}"] for cells in (15, 30, 60, 120, 240)]
    assert levels == [40, 32, 24, 16, 8]
    assert [a["groups"][0][f"pck{limit}"] for limit in (1, 3, 5)] == [0.25, 0.5, 1]
    assert a["reliability"]["counts"] == [8, 0, 0, 0, 0, 0, 0, 0, 0, 4]
    assert a["reliability"]["share_correct"][:2] == [0.5, None]
    assert b["reliability"] is None and b["all"]["jaccard"] is None


def test_the_reliability_on_a_line_for_each_method_with_a_mask(scores) -> None:
    assert reliability_lines(scores) == [
        "a: percent within 3 px by tenths of matchability: 50 - - - - - - - - 100; "
        "expected calibration error 31.7 %"
    ]
