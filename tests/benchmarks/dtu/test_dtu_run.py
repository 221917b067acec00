"""The benchmark's loop: its rows are right, and the same however the work is cut up."""

from __future__ import annotations

from dataclasses import asdict, replace

import dense_scene
import dtu_entries
import numpy as np
import pytest
from dtu_entries import FAST, METHODS

from dgc_pose.benchmarks.dtu.methods import Method
from dgc_pose.benchmarks.dtu.run import RunOptions, run
from dgc_pose.benchmarks.dtu.scoring import Scored, pair_seed
from dgc_pose.errors import ImageError, InputError
from dgc_pose.matches import Matches


def _rows(entries, options=FAST, first=0, methods=METHODS) -> list[list[Scored]]:
    return list(run(entries, methods, dtu_entries.engines(), options, first))


def _results(rows) -> list[dict[str, object]]:
    return [asdict(one.result) for scored in rows for one in scored]


def test_a_row_a_pair_and_method_in_order(tmp_path) -> None:
    rows = _rows(dtu_entries.entries(tmp_path, 3))
    keys = [one.result.key for scored in rows for one in scored]
    assert keys == [(m.name, 65, 1, view2) for view2 in (2, 3, 4) for m in METHODS]
    assert keys == [one.timing.key for scored in rows for one in scored]
    true = rows[0][0].result
    assert true.success and true.rotation_error_deg < 0.5 and true.translation_error_deg < 2
    assert true.true_baseline_mm == 120 and true.overlap == 0.8 and true.protocol == "native"
    assert true.true_rotation_deg == pytest.approx(
        np.degrees(np.arccos((np.trace(dense_scene.R) - 1) / 2)), abs=1e-4
    )


def test_the_epipolar_error_is_that_of_the_map(tmp_path) -> None:
    """Noise of sigma in each coordinate of image 1 is a distance to the line with a median of
    0.67 sigma there; the distance in image 2 is about the same, the views being alike."""
    for scored in _rows(dtu_entries.entries(tmp_path, 4)):
        sigma = 0.05 * scored[0].result.view2
        for one in scored[:2]:
            assert one.result.epipolar_all_px == pytest.approx(0.67 * sigma, rel=0.1)
            assert one.result.epipolar_all_mean_px == pytest.approx(0.8 * sigma, rel=0.1)
        assert np.isnan(scored[2].result.epipolar_all_px)
        assert scored[2].result.epipolar_confident_px < 1e-3


def test_all_takes_what_the_mask_leaves_out(tmp_path) -> None:
    """The cells whose place lies outside image 1 never become matches; matchability aside."""
    (entry,) = dtu_entries.entries(tmp_path, 1)
    unlimited = replace(FAST, protocol="paper")
    masked, everywhere, some = (s.result.num_matches for s in _rows([entry], unlimited)[0])
    found = dense_scene.true_map(error_px=0.1)
    # The map is that of dense_scene whatever the protocol: its own size decides what is inside.
    inside = (found.map >= -0.5).all(-1) & (found.map <= np.array(dense_scene.SIZE) - 0.5).all(-1)
    assert masked == int((found.matchability > 0.5).sum()) and everywhere == int(inside.sum())
    assert some == 60


@pytest.mark.parametrize("options", [replace(FAST, batch=2), replace(FAST, workers=2, batch=4)])
def test_the_rows_hang_on_neither_workers_nor_batches(tmp_path, options: RunOptions) -> None:
    entries = dtu_entries.entries(tmp_path, 5)
    expected = _results(_rows(entries))
    np.testing.assert_equal(_results(_rows(entries, options)), expected)


@pytest.mark.parametrize("batch", [1, 3])
def test_a_run_that_goes_on_gives_the_remaining_rows(tmp_path, batch: int) -> None:
    entries = dtu_entries.entries(tmp_path, 5)
    options = replace(FAST, batch=batch)
    whole = _rows(entries, options)
    for first in range(6):
        rest = _rows(entries, options, first)
        np.testing.assert_equal(_results(rest), _results(whole[first:]))


def test_a_batch_begins_where_it_would_have_begun(tmp_path) -> None:
    """After a kill in the middle of a batch, the network sees the same batch again."""
    entries = dtu_entries.entries(tmp_path, 5)
    seen: list[list[int]] = []
    engines = dtu_entries.engines()
    net = engines.by_name["net"]

    def remembered(shown):
        seen.append([one.view2 for one in shown])
        return net(shown)

    engines = replace(engines, by_name={"net": remembered})
    list(run(entries, METHODS[:1], engines, replace(FAST, batch=2), first=3))
    assert seen == [[4, 5], [6]]


def test_methods_of_one_engine_share_its_pass(tmp_path) -> None:
    entries = dtu_entries.entries(tmp_path, 2)
    calls = []
    engines = dtu_entries.engines()
    net = engines.by_name["net"]
    counted = replace(engines, by_name={"net": lambda shown: calls.append(1) or net(shown)})
    rows = list(run(entries, METHODS[:2], counted, FAST))
    assert len(calls) == 2 and len(rows[0]) == 2


def test_a_refiner_sees_the_trusted_matches_alone(tmp_path) -> None:
    """Of two methods of one engine the one without a mask keeps its matches."""

    class Halves:
        def refine(self, image1, image2, found, matches):
            assert image1.size == found.size1 and len(matches) <= 400
            return Matches(
                matches.points1[::2], matches.points2[::2], matches.confidence[::2], 0.25
            )

    entries = dtu_entries.entries(tmp_path, 1)
    engines = dtu_entries.engines()
    (plain,) = run(entries, METHODS, engines, FAST)
    (halved,) = run(entries, METHODS, replace(engines, refiners={"net": Halves()}), FAST)
    counts = [[one.result.num_matches for one in scored] for scored in (plain, halved)]
    assert counts[1] == [-(-counts[0][0] // 2), *counts[0][1:]]


def test_another_seed_gives_other_poses(tmp_path) -> None:
    entries = dtu_entries.entries(tmp_path, 2)
    other = replace(FAST, estimation=replace(FAST.estimation, seed=1))
    assert _results(_rows(entries)) != _results(_rows(entries, other))
    seeds = {pair_seed(s, a, b, c) for s in (0, 1) for a in (1, 2) for b in (1, 2) for c in (1, 2)}
    assert len(seeds) == 16


def test_a_sample_is_of_the_matches_and_tells_inliers(tmp_path) -> None:
    (scored,) = _rows(dtu_entries.entries(tmp_path, 1))
    for one in scored:
        sample = one.sample
        assert len(sample) == 60
        assert sample.inliers.mean() == pytest.approx(one.result.inlier_ratio, abs=0.25)
        places = dense_scene.points_in_image1(sample.points2)
        assert np.abs(sample.points1 - places).max() < 1


def test_what_cannot_be_used_is_refused(tmp_path) -> None:
    (entry,) = dtu_entries.entries(tmp_path, 1)
    with pytest.raises(InputError, match="points and no map"):
        _rows([entry], methods=[Method("some/all", "some", everywhere=True)])
    (tmp_path / "two.png").write_bytes(b"no image")
    with pytest.raises(ImageError, match="two.png"):
        _rows([entry], replace(FAST, workers=2))
    for name in ("workers", "batch"):
        with pytest.raises(InputError, match=name):
            replace(FAST, **{name: 0})
