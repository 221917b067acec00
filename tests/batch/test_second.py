"""The pairs of a folder that a second matcher matches too."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from batch_runs import QUICK, Killed, assert_same_result, killed_after, run_sift, view_folder

from dgc_pose.batch.result import MISSING, Batch
from dgc_pose.images.image import Image
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import MatchResult
from dgc_pose.matching.key_points import SiftMatcher

_ALONE = "view3.png"  # its matches are wrong, but for the second matcher
_JOINING = {(f"view{k}.png", _ALONE) for k in range(3)}


@dataclass
class _Second:
    """SIFT with matches of view3 that agree only with the second step; `tried` has its pairs."""

    fingerprint: str | None = "first of its kind"
    tried: list[tuple[str, str]] = field(default_factory=list)

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        whole: Callable[..., MatchResult] = SiftMatcher.match

        def match(matcher: SiftMatcher, image1: Image, image2: Image) -> MatchResult:
            found = whole(matcher, image1, image2)
            if Path(image2.name).name != _ALONE:
                return found
            rng = np.random.default_rng(0)
            wrong = rng.permutation(found.matches.points1)
            return replace(found, matches=replace(found.matches, points1=wrong))

        def second(
            matcher: SiftMatcher, image1: Image, image2: Image, result: MatchResult
        ) -> MatchResult:
            self.tried.append((Path(image1.name).name, Path(image2.name).name))
            return whole(matcher, image1, image2)

        monkeypatch.setattr(SiftMatcher, "match", match)
        monkeypatch.setattr(SiftMatcher, "second", second)
        monkeypatch.setattr(MatcherOptions, "takes_second", True)
        run = "dgc_pose.batch.run"
        monkeypatch.setattr(f"{run}.is_available", lambda: self.fingerprint is not None)
        monkeypatch.setattr(f"{run}.installed_fingerprint", lambda: self.fingerprint)
        monkeypatch.setattr(f"{run}.LightGlueMatcher", lambda: None)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("views")
    view_folder(folder, 4)
    return folder


@pytest.fixture
def second(monkeypatch: pytest.MonkeyPatch) -> _Second:
    second = _Second()
    second.install(monkeypatch)
    return second


def _tried(batch: Batch) -> set[tuple[str, str]]:
    return {row.names for row in batch.rows if row.second}


@pytest.mark.parametrize("K", ["auto", None])
def test_pairs_that_would_join_two_groups_are_matched_with_it(
    views: Path, second: _Second, tmp_path: Path, K: str | None
) -> None:
    known = {} if K is None else {"K": K}
    batch = run_sift(views, tmp_path / "out", **known)
    assert set(second.tried) == _tried(batch) == _JOINING
    assert all(row.success for row in batch.rows)
    again = run_sift(views, tmp_path / "out", resume=True, **known)
    assert len(second.tried) == 3 and _tried(again) == _JOINING


def test_a_batch_that_is_killed_meanwhile_goes_on(
    views: Path, second: _Second, tmp_path: Path
) -> None:
    run_sift(views, tmp_path / "whole")
    for after in (7, 1):
        with pytest.raises(Killed):
            run_sift(views, tmp_path / "out", start_workers=killed_after(after), resume=after == 1)
    run_sift(views, tmp_path / "out", resume=True)
    assert_same_result(tmp_path / "whole", tmp_path / "out")
    assert len(second.tried) < 9


def test_with_another_one_or_none_its_pairs_are_matched_anew(
    views: Path, second: _Second, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run_sift(views, out)
    second.fingerprint = "another"
    run_sift(views, out, resume=True)
    assert len(second.tried) == 6
    second.fingerprint = None
    batch = run_sift(views, out, resume=True)
    assert len(second.tried) == 6 and not _tried(batch)
    assert batch.plan.settings["second"] == MISSING
    assert not any(row.success for row in batch.rows if row.names in _JOINING)


@pytest.mark.parametrize(
    "estimation", [replace(QUICK, second="none"), replace(QUICK, effort="fast")]
)
def test_it_may_be_left_out(views: Path, second: _Second, tmp_path: Path, estimation) -> None:
    batch = run_sift(views, tmp_path / "out", estimation=estimation)
    assert not second.tried and not _tried(batch)
    assert batch.plan.settings["second"] is None
