"""The verdict of matches in a world of points: right poses are claimed, photographs of another
place are not, and one unusable pair stops no other."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from given_world import given_world, write_hloc, write_npz, write_with_pycolmap
from results import pair_row
from worlds import CAMERA, IMAGE

from dgc_pose import Camera, EstimationOptions, InputError, Matches, judge
from dgc_pose.batch.judge import by_doubt
from dgc_pose.batch.pairs import PairRow
from dgc_pose.estimation import Status

WORLD = given_world(count=4)
QUICK = EstimationOptions(runs=1, iterations=300)


def held() -> dict[tuple[str, str], Matches]:
    """The matches in memory."""
    return {
        names: Matches(*WORLD.points(names), np.ones(len(index)), 1.0, key_points=True)
        for names, index in WORLD.matches.items()
    }


def assert_right(rows: list[PairRow]) -> None:
    """Exactly the related pairs have a pose, and it is the true one."""
    assert {frozenset(row.names) for row in rows} == {frozenset(pair) for pair in WORLD.matches}
    for row in rows:
        is_unrelated = row.names in WORLD.unrelated or row.names[::-1] in WORLD.unrelated
        assert row.success != is_unrelated, row
        if row.success:
            assert row.pose is not None and not row.rejected
            assert max(WORLD.errors_deg(row.names, row.pose.R, row.pose.t)) < 1.5


@pytest.mark.parametrize("write", [write_with_pycolmap, write_hloc, write_npz])
def test_a_source_of_any_kind(tmp_path: Path, write: Callable[..., Path]) -> None:
    source = write(WORLD, tmp_path / "source.db")
    K = None if write is write_with_pycolmap else CAMERA
    rows = judge(source, K, options=QUICK)
    assert_right(rows)
    assert list(map(id, rows)) == list(map(id, by_doubt(rows)))


def test_matches_in_memory() -> None:
    """With a camera by name; the inliers are over the matches."""
    matches = held()
    rows = judge(matches, dict.fromkeys(WORLD.names, CAMERA), options=QUICK)
    assert_right(rows)
    for row in rows:
        if row.success:
            assert row.pose is not None
            right = WORLD.right[row.names]
            assert row.pose.inliers.shape == right.shape and row.pose.inliers.dtype == bool
            assert right[row.pose.inliers].mean() > 0.95 and row.pose.inliers[right].mean() > 0.9
    (again,) = judge({rows[0].names: matches[rows[0].names]}, CAMERA.K, options=QUICK)
    assert np.array_equal(again.pose.R, rows[0].pose.R)


def test_cameras_without_a_focal_length_are_estimated(tmp_path: Path) -> None:
    world = given_world(count=3, unrelated=0)
    rows = judge(write_with_pycolmap(world, tmp_path / "a.db", known=False), options=QUICK)
    poses = [row.pose for row in rows if row.success]
    assert poses and all(pose.camera1.focal_std > 0 for pose in poses if pose and pose.camera1)


def test_unusable_pairs_stop_no_other() -> None:
    a, b, c, d = "abcd"
    first = next(iter(WORLD.matches))
    good = held()[first]
    outside = replace(good, points1=good.points1 + IMAGE)
    unknown = replace(good, points1=np.full_like(good.points1, np.nan))
    empty = good.subset(np.zeros(len(good), bool))
    pairs = {(a, b): good, (a, a): good, (a, c): outside, (b, c): unknown, (b, d): empty}
    rows = {row.names: row for row in judge(pairs, CAMERA, options=QUICK)}
    assert rows[a, b].success
    expected = {
        (a, a): ("bad_input", "matches of a with itself"),
        (a, c): ("bad_input", "lie outside the 1000x800 pixels of camera1"),
        (b, c): ("too_few_matches", "only 0 matches"),
        (b, d): ("too_few_matches", "only 0 matches"),
    }
    for names, (status, reason) in expected.items():
        assert rows[names].status == status and reason in rows[names].reason
    with pytest.raises(InputError, match=r"no pair can be judged \(a a: matches of a with itself"):
        judge({(a, a): good}, CAMERA)


def test_an_index_beyond_the_key_points(tmp_path: Path) -> None:
    matches = dict(WORLD.matches)
    odd = next(iter(matches))
    matches[odd] = np.where(matches[odd] == 7, 1000, matches[odd]).astype(np.uint32)
    source = write_with_pycolmap(replace(WORLD, matches=matches), tmp_path / "a.db")
    rows = judge(source, options=QUICK)
    (bad,) = (row for row in rows if row.status == "bad_input")
    assert bad.names == odd[::-1] and "a match has key point 1000 of" in bad.reason
    assert sum(row.success for row in rows) == 2


def test_an_image_without_a_camera() -> None:
    cameras = {name: CAMERA for name in WORLD.names[1:]}
    rows = judge(held(), cameras, options=QUICK)
    bad = [row for row in rows if WORLD.names[0] in row.names]
    assert len(bad) == 3 and all(row.status == "bad_input" for row in bad)
    assert f"{WORLD.names[0]} has no camera" in bad[0].reason
    with pytest.raises(InputError, match="rows/photo 0.jpg has no camera"):
        judge(held(), {"other.jpg": CAMERA})


def test_the_pairs_in_doubt_come_first() -> None:
    """The claims, then the pairs that the folder rejects and those without a pose."""

    def row(name: str, probability: float | None, status: Status = "ok", **more: float) -> PairRow:
        return replace(pair_row((name, "b"), status, probability=probability), **more)

    rows = [
        row("sure", 0.99),
        row("none", 0.0, "improbable"),
        row("rejected", 0.7, folder_probability=0.1),
        row("doubt", 0.6),
        row("folder", None, folder_probability=0.9),
    ]
    names = [row.name1 for row in by_doubt(rows)]
    assert names == ["doubt", "folder", "sure", "none", "rejected"]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (({},), "source has no pairs"),
        ((3,), "source must be"),
        (({("a", "b"): 3}, Camera(np.eye(3))), "source must be a Matches, not 3"),
        (({"a": 3}, Camera(np.eye(3))), "source must be a tuple of 2, not 'a'"),
        (({(1, 2): 3}, Camera(np.eye(3))), "source must be a text, not 1"),
    ],
)
def test_unusable_arguments(arguments: tuple[object, ...], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        judge(*arguments)  # type: ignore[arg-type]
