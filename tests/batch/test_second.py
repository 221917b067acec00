"""The pairs of a folder that a second matcher matches too."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from batch_runs import QUICK, Killed, assert_same_result, killed_after, run_sift

from dgc_pose.batch.result import MISSING, Batch
from dgc_pose.images.image import Image
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import MatchResult
from dgc_pose.matching.key_points import SiftMatcher

_ALONE = "view2.png"  # its matches are wrong, but for the second matcher
_JOINING = {(f"view{k}.png", _ALONE) for k in range(2)}


@dataclass
class _Second:
    """SIFT with matches of view2 that agree only with the second step; `tried` has its pairs."""

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
        # Near its limit, as these pairs are; test_groups.py has it.
        monkeypatch.setattr("dgc_pose.batch.groups.is_hopeless", lambda pose: False)
        run = "dgc_pose.batch.run"
        monkeypatch.setattr(f"{run}.is_available", lambda: self.fingerprint is not None)
        monkeypatch.setattr(f"{run}.installed_fingerprint", lambda: self.fingerprint)
        monkeypatch.setattr(f"{run}.LightGlueMatcher", lambda: None)


@pytest.fixture(scope="module")
def three(views: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("three")
    for k in range(3):
        shutil.copy(views / f"view{k}.png", folder)
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
    three: Path, second: _Second, tmp_path: Path, K: str | None
) -> None:
    known = {} if K is None else {"K": K}
    batch = run_sift(three, tmp_path / "out", **known)
    assert set(second.tried) == _tried(batch) == _JOINING
    assert all(row.success for row in batch.rows)
    again = run_sift(three, tmp_path / "out", resume=True, **known)
    assert len(second.tried) == 2 and _tried(again) == _JOINING


def test_a_batch_that_is_killed_meanwhile_goes_on(
    three: Path, second: _Second, tmp_path: Path
) -> None:
    run_sift(three, tmp_path / "whole")
    for after in (4, 0):
        with pytest.raises(Killed):
            run_sift(three, tmp_path / "out", start_workers=killed_after(after), resume=after == 0)
    run_sift(three, tmp_path / "out", resume=True)
    assert_same_result(tmp_path / "whole", tmp_path / "out")
    assert len(second.tried) == 6  # two were lost, of which one was begun twice


def test_with_another_second_matcher_or_none_its_pairs_are_matched_anew(
    three: Path, second: _Second, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run_sift(three, out)
    second.fingerprint = "another"
    run_sift(three, out, resume=True)
    assert len(second.tried) == 4
    second.fingerprint = None
    batch = run_sift(three, out, resume=True)
    assert len(second.tried) == 4 and not _tried(batch)
    assert batch.plan.settings["second"] == MISSING
    assert not any(row.success for row in batch.rows if row.names in _JOINING)


@pytest.mark.parametrize(
    "estimation", [replace(QUICK, second="none"), replace(QUICK, effort="fast")]
)
def test_the_second_matcher_may_be_left_out(
    three: Path, second: _Second, tmp_path: Path, estimation
) -> None:
    batch = run_sift(three, tmp_path / "out", estimation=estimation)
    assert not second.tried and not _tried(batch)
    assert batch.plan.settings["second"] is None
