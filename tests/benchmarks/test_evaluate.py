"""The benchmarks' loop: its records are right, and the same however the work is cut up."""

from dataclasses import asdict

import dense_scene
import numpy as np
import pytest
from evaluation_pairs import (
    METHODS,
    evaluation,
    posed_pairs,
)

from dgc_pose.benchmarks.methods import parse_methods
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.errors import ImageError, InputError
from dgc_pose.matching.texture import texture


def _rows(pairs, first=0, methods=None, **numbers) -> list[list[DtuScore]]:
    return list(evaluation(pairs, methods, **numbers).run(first))


def _results(rows) -> list[dict[str, object]]:
    """The records without their times."""
    return [
        {k: v for k, v in asdict(one).items() if not k.endswith("_seconds")}
        for scored in rows
        for one in scored
    ]


def test_a_row_a_pair_and_method_in_order(tmp_path) -> None:
    rows = _rows(posed_pairs(tmp_path, 3))
    keys = [(one.method, one.view1, one.view2) for scored in rows for one in scored]
    assert keys == [(m.name, 1, view2) for view2 in (2, 3, 4) for m in METHODS]
    assert all(one.match_seconds >= 0 for scored in rows for one in scored)
    assert all(one.estimate_seconds > 0 for scored in rows for one in scored)
    true = rows[0][0]
    assert true.success and true.rotation_error_deg < 0.5 and true.translation_error_deg < 2
    assert true.true_baseline_mm == 120 and true.overlap == 0.8 and true.protocol == "native"
    assert true.true_rotation_deg == pytest.approx(
        np.degrees(np.arccos((np.trace(dense_scene.R) - 1) / 2)), abs=1e-4
    )


def test_the_epipolar_error_is_that_of_the_map(tmp_path) -> None:
    """Noise of sigma in each coordinate of image 1 is a distance to the line with a median of
    0.67 sigma there; the distance in image 2 is about the same, the views being alike."""
    for scored in _rows(posed_pairs(tmp_path, 4)):
        sigma = 0.05 * scored[0].view2
        for one in scored[:2]:
            assert one.epipolar_all_px == pytest.approx(0.67 * sigma, rel=0.1)
            assert one.epipolar_all_mean_px == pytest.approx(0.8 * sigma, rel=0.1)
        assert np.isnan(scored[2].epipolar_all_px)
        assert scored[2].epipolar_confident_px < 1e-3


def test_all_takes_what_the_mask_leaves_out(tmp_path, monkeypatch) -> None:
    """The cells whose place lies outside image 1 never become matches; matchability aside."""
    # The map is that of dense_scene whatever the protocol.
    monkeypatch.setattr("dgc_pose.benchmarks.dtu.dtu_pairs.PAPER_SIZE", dense_scene.SIZE)
    unlimited = posed_pairs(tmp_path, 1, "paper")
    masked, everywhere, some = (s.num_matches for s in _rows(unlimited)[0])
    found = dense_scene.true_map(error_px=0.1)
    inside = (found.map >= -0.5).all(-1) & (found.map <= np.array(dense_scene.SIZE) - 0.5).all(-1)
    (pair,) = unlimited.read()
    structured = texture(pair.image1).at(found.map.reshape(-1, 2))
    structured &= texture(pair.image2).at(found.grid.reshape(-1, 2))
    trusted = (found.matchability > 0.5).ravel()
    assert masked == int((trusted & structured).sum()) > 1000
    assert everywhere == int(inside.sum()) > masked
    assert 40 < some <= 60  # points, those with structure


def test_the_records_are_independent_of_workers_and_of_the_first_pair(tmp_path) -> None:
    pairs = posed_pairs(tmp_path, 4)
    whole = _results(_rows(pairs))
    np.testing.assert_equal(_results(_rows(pairs, workers=2)), whole)
    np.testing.assert_equal(_results(_rows(pairs, 3)), whole[3 * len(METHODS) :])


def test_what_cannot_be_used_is_refused(tmp_path) -> None:
    pairs = posed_pairs(tmp_path, 1)
    with pytest.raises(InputError, match="some/all: some makes no map"):
        _rows(posed_pairs(tmp_path, 1), methods=parse_methods(["some/all"]))
    (tmp_path / "two_2.png").write_bytes(b"no image")
    with pytest.raises(ImageError, match="two_2.png"):
        _rows(pairs, workers=2)
