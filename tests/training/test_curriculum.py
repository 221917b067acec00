"""A curriculum: narrow ranges first, the full ones in the end."""

from __future__ import annotations

import pytest
import torch

from dgc_pose.errors import InputError
from dgc_pose.synthesis.options import PAPER_AFFINE, WARPS, PairOptions
from dgc_pose.synthesis.warps import random_warp
from dgc_pose.training.curriculum import Curriculum


def test_ranges_grow_to_the_full_ones() -> None:
    full = PairOptions()
    curriculum = Curriculum(start=0.25, ramp=0.4)
    steps = [curriculum.at(progress, full) for progress in (0.0, 0.1, 0.2, 0.39)]
    for name in ("translation", "tps_sigma", "corner_shift", "affine_rotation_deg"):
        values = [getattr(step.warps, name) for step in steps]
        assert values == sorted(values) and len(set(values)) == len(values)
        assert values[0] == pytest.approx(0.25 * getattr(full.warps, name))
    angles = [step.scenes.rotation_deg[1] for step in steps]
    assert angles == sorted(angles) and angles[0] == pytest.approx(2 + 0.25 * 43)
    assert all(step.scenes.rotation_deg[0] == full.scenes.rotation_deg[0] for step in steps)
    for progress in (0.4, 1.0):
        assert curriculum.at(progress, full) == full


def test_what_is_no_range_stays() -> None:
    full = PairOptions(scene_share=0.3, real_share=0.2)
    early = Curriculum().at(0.0, full)
    assert (early.scene_share, early.real_share) == (0.3, 0.2)
    assert early.photometric == full.photometric and early.real == full.real
    assert early.warps.affine_share == full.warps.affine_share


def test_early_warps_move_points_less() -> None:
    axis = torch.linspace(-1, 1, 5)
    grid = torch.cartesian_prod(axis, axis).repeat(200, 1, 1)
    for name, warps in WARPS.items():
        full = PairOptions(warps=warps)
        moves = []
        for options in (Curriculum(start=0.3).at(0.0, full), full):
            warp = random_warp(200, options.warps, torch.Generator().manual_seed(0))
            moves.append(float((warp(grid) - grid).norm(dim=-1).median()))
        assert moves[0] < 0.6 * moves[1], name


def test_presets_are_of_their_kinds() -> None:
    """Affine maps keep the middle of two points; nothing else here does so everywhere."""
    points = torch.tensor([[[-0.6, 0.1], [0.0, 0.3], [0.6, 0.5]]]).repeat(300, 1, 1)
    shares = {}
    for name, warps in WARPS.items():
        moved = random_warp(300, warps, torch.Generator().manual_seed(1))(points)
        off = (moved[:, 0] + moved[:, 2] - 2 * moved[:, 1]).norm(dim=-1)
        shares[name] = float((off < 1e-4).float().mean())
    assert shares["paper-affine"] == 1 and shares["paper-homography"] < 0.02
    assert abs(shares["paper-affine-tps"] - 0.5) < 0.08
    assert abs(shares["paper"] - 0.25) < 0.08 and WARPS["paper-affine"] is PAPER_AFFINE


@pytest.mark.parametrize(("field", "value"), [("start", 0.0), ("ramp", 1.5)])
def test_wrong_options_are_refused(field: str, value: float) -> None:
    with pytest.raises(InputError, match=field):
        Curriculum(**{field: value})
