"""A compact state: smaller, and nearly the same."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
import torch
from photo_folder import drawn_photos

from dgc_pose.training.compact import compacted, expanded
from dgc_pose.training.pairs import PairOptions
from dgc_pose.training.photos import Photos
from dgc_pose.training.run import CHECKPOINT, RunOptions, Trainer


@pytest.fixture(scope="module")
def photos() -> Photos:
    return drawn_photos(4, 64)


def _size(state: dict[str, object]) -> int:
    file = io.BytesIO()
    torch.save(state, file)
    return len(file.getvalue())


@pytest.mark.parametrize("progress", [0.2, 0.6])
def test_a_run_goes_on_from_a_compact_state(
    photos: Photos, tmp_path: Path, progress: float
) -> None:
    pairs = PairOptions(scene_share=0.0)
    options = RunOptions("dgcm-lite", 1.0, pairs=pairs, validation_count=1, batch=1)
    trainer = Trainer((photos, photos), tmp_path / "a", options)
    for _ in range(2):
        trainer.train_step(progress)
    whole = trainer.state()
    small = compacted(whole)
    # 4 bytes each for weight, average and two moments become 2 and 1; less of what is frozen.
    assert _size(small) < 0.32 * _size(whole)
    back = expanded(small)
    for key, value in whole["module"].items():
        torch.testing.assert_close(back["module"][key], value, rtol=1e-3, atol=1e-6)
    for index, moments in whole["optimizer"]["state"].items():
        kept = back["optimizer"]["state"][index]
        assert kept["step"] == moments["step"] and not kept["exp_avg"].any()
        second, expected = kept["exp_avg_sq"], moments["exp_avg_sq"]
        large = expected > 1e-6 * expected.max()
        torch.testing.assert_close(second[large], expected[large], rtol=0.05, atol=0)
        assert (second >= 0.95 * expected).all()  # where it is off, steps are smaller, not larger
    (tmp_path / "b").mkdir()
    torch.save(small, tmp_path / "b" / CHECKPOINT)
    resumed = Trainer((photos, photos), tmp_path / "b", options, resume=True)
    assert resumed.step == 2 and resumed.stage == trainer.stage
    found, expected = (float(t.train_step(progress)["loss"]) for t in (resumed, trainer))
    assert found == pytest.approx(expected, rel=0.05)


def test_a_whole_state_is_left_as_it_is() -> None:
    state = {"module": {}, "step": 3}
    assert expanded(state) is state
