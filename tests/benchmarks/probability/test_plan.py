"""Plans of scenes and their parts."""

import json

import pytest

from dgc_pose.benchmarks.probability.plan import read_plan
from dgc_pose.errors import InputError

# Scenes that accuracy is reported on, never fitted on.
EVALUATION = ("7scenes_a", "mamechun_room", "nan_room", "eunseon_desk")
ENTRIES = [
    {"name": "a", "part": "fit", "kind": "rgbd", "path": "a"},
    {"name": "b", "part": "fit", "kind": "sparse", "path": "b", "pairs": 3},
    {"name": "c", "part": "report", "kind": "unrelated", "path": ["c", "d"], "rough": ["c"]},
]


def test_a_plan_names_its_sources(tmp_path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(ENTRIES))
    found = read_plan(path)
    assert [(one.name, one.part, one.kind) for one in found] == [
        ("a", "fit", "rgbd"),
        ("b", "fit", "sparse"),
        ("c", "report", "unrelated"),
    ]
    assert [len(one.path) for one in found] == [1, 1, 2] and found[1].pairs == 3
    assert [one.rough for one in found] == [(), (), ("c",)]


@pytest.mark.parametrize(
    "entries",
    [
        "no plan",
        [],
        ENTRIES[:2],  # nothing to report on
        [*ENTRIES, ENTRIES[0]],  # a scene twice
        [*ENTRIES, {"name": "d", "part": "fit", "kind": "film", "path": "d"}],
        [*ENTRIES, {"name": "d", "part": "fit", "kind": "rgbd", "pairs": 0}],
    ],
)
def test_what_is_no_plan_is_refused_by_its_path(entries, tmp_path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(entries if isinstance(entries, str) else json.dumps(entries))
    with pytest.raises(InputError, match="plan.json"):
        read_plan(path)


def test_the_project_s_plan_fits_on_no_scene_that_it_reports_on() -> None:
    for source in read_plan(None):
        names = " ".join(map(str, source.path))
        if source.part != "report":
            assert not any(scene in names for scene in EVALUATION)
            assert "evaluation" not in names and "strecha" not in names
