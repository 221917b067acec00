"""Plans of scenes and their parts."""

import gzip
import json
from dataclasses import replace

import pytest

from dgc_pose.benchmarks.probability.plan import DEFAULT_PLAN, read_plan
from dgc_pose.benchmarks.probability.planned import planned
from dgc_pose.cameras.pair_list import rendered_pair, write_pairs
from dgc_pose.errors import InputError

# Scenes that accuracy is reported on, never fitted on.
EVALUATION = ("7scenes_a", "mamechun_room", "nan_room", "eunseon_desk")
ENTRIES = [
    {"name": "a", "part": "fit", "kind": "list", "path": "a", "scene_by_folder": True},
    {"name": "b", "part": "fit", "kind": "rendered", "path": "b", "pairs": 3},
    {"name": "c", "part": "report", "kind": "unrelated", "rough": ["c"]},
]


def test_a_plan_names_its_sources_and_has_their_lists(tmp_path):
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(ENTRIES))
    found = read_plan(path)
    assert [(one.name, one.part, one.kind) for one in found] == [
        ("a", "fit", "list"),
        ("b", "fit", "rendered"),
        ("c", "report", "unrelated"),
    ]
    assert found[1].pairs == 3 and [*found[2].rough] == ["c"]
    pairs = [replace(rendered_pair(), name1=f"{place}/1.jpg", name2="2.jpg") for place in "xy"]
    for pair in pairs:
        for name in (pair.name1, pair.name2):
            (tmp_path / "a" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "a" / name).touch()
    write_pairs(tmp_path / "a.txt", pairs)
    packed = tmp_path / "a.txt.gz"
    packed.write_bytes(gzip.compress((tmp_path / "a.txt").read_bytes()))
    assert [one.scene for one in planned(found[0], tmp_path, tmp_path)] == ["x", "y"]
    packed.write_bytes(packed.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"a\.txt\.gz is not a packed list of pairs"):
        planned(found[0], tmp_path, tmp_path)


@pytest.mark.parametrize(
    "entries",
    [
        "no plan",
        [*ENTRIES, ENTRIES[0]],  # a scene twice
        [*ENTRIES, {"name": "d", "part": "fit", "kind": "film", "path": "d"}],
        [*ENTRIES, {"name": "d", "part": "fit", "kind": "rendered", "pairs": 0}],
    ],
)
def test_what_is_no_plan_is_refused_by_its_path(entries, tmp_path):
    path = tmp_path / "plan.json"
    path.write_text(entries if isinstance(entries, str) else json.dumps(entries))
    with pytest.raises(InputError, match="plan.json"):
        read_plan(path)


def test_the_project_s_plan_fits_on_no_scene_that_it_reports_on():
    for source in read_plan(DEFAULT_PLAN):
        lines = []
        if source.kind in ("list", "unrelated"):
            path = DEFAULT_PLAN.parent / "lists" / f"{source.name}.txt.gz"
            lines = gzip.decompress(path.read_bytes()).decode().splitlines()
            assert lines
        if source.part != "report":
            names = [source.path.as_posix(), *(n for line in lines for n in line.split()[:2])]
            assert not any(scene in name for name in names for scene in EVALUATION)
            assert not source.path.match("strecha")
