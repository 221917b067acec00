"""Batches of all kinds, and the data that they are made of."""

import cv2
import numpy as np
import pytest
import torch
from rendered import rendered, write_rgbd
from textures import drawn_photos, write_photos

from dgc_pose.errors import InputError
from dgc_pose.training import pairs as pairs_module
from dgc_pose.training.draw import Draw
from dgc_pose.training.options import Shares
from dgc_pose.training.pairs import TRAINING, PairSource, load_data, warped_pairs
from dgc_pose.training.photos import Photos
from dgc_pose.training.views import MapPairs, Shape


def test_a_batch_has_its_shares_and_a_small_one_has_all_kinds_in_turn(monkeypatch):
    made: list[int] = []

    def counted(photos: Photos, count: int, shape: Shape, draw: Draw, light: bool) -> MapPairs:
        made.append(count * light)
        return warped_pairs(photos, count, shape, draw, light)

    monkeypatch.setattr(pairs_module, "warped_pairs", counted)
    for count, share, batches in ((25, 0.12, 8), (4, 0.2, 50)):
        source = PairSource(drawn_photos(2, 16, places=1), shares=Shares(1 - share, share, 0, 0))
        numbers = []
        for k in range(batches):
            made.clear()
            assert len(source.make(count, (16, 16), Draw("cpu", k)).map) == count
            numbers.append(sum(made))
        assert sum(numbers) / batches == pytest.approx(count * share, abs=0.25)
        assert max(numbers) - min(numbers) <= 1


def test_batches_repeat_and_are_of_the_shape_asked_for():
    source = PairSource(drawn_photos(6, 64, places=2), shares=Shares(0.4, 0.3, 0.3, 0.5))
    pairs, again, other = (source.make(5, (48, 80), Draw("cpu", seed)) for seed in (0, 0, 1))
    assert pairs.image1.shape == (5, 3, 48, 80) and pairs.map.shape == (5, 48, 80, 2)
    assert torch.equal(pairs.image2, again.image2) and not torch.equal(pairs.map, other.map)
    assert not (pairs.valid & ~pairs.known).any()
    with pytest.raises(InputError, match="no data for the kinds"):
        PairSource(drawn_photos(2, 64), shares=Shares(0, 0.5, 0, 0.5)).make(
            1, (48, 48), Draw("cpu")
        )


def test_shares_are_read_from_percentages():
    assert Shares.parse("50, 0,25,25") == Shares(0.5, 0, 0.25, 0.25)
    for text in ("45,55", "a,b,c,d", "", "0,0,0,0", "-1,1,1,1", "nan,1,1,1"):
        with pytest.raises(InputError, match="four percentages"):
            Shares.parse(text)


def test_held_scenes_validate_and_the_others_train(tmp_path):
    write_photos(tmp_path / "photos", 40)
    for k, name in enumerate("ab"):
        write_rgbd(tmp_path / "posed" / name, rendered(3 + k, (96, 72)))
    folders = {"photos": tmp_path / "photos", "posed": [tmp_path / "posed"]}
    data = load_data(**folders, depths=tmp_path, held=["b"], shares=Shares())
    assert list(data) == [TRAINING, "photos", "rooms", "posed"]
    training, validating = data[TRAINING].posed, data["posed"].posed
    assert training is not None and validating is not None
    assert set(training.frames.flatten().tolist()) == {0, 1}
    assert set(validating.frames.flatten().tolist()) == {2, 3}
    for source in data.values():
        assert source.make(2, (48, 48), Draw("cpu", 0)).valid.any()
    data = load_data(**folders, depths=tmp_path, shares=Shares(1, 0, 0, 0))
    assert data[TRAINING].posed is None  # without a share nothing is prepared
    for path in (tmp_path / "posed/b/depth").iterdir():  # b is blind from now on
        cv2.imwrite(str(path), np.zeros((72, 96), np.uint16))
    for posed, held, message in (
        (["."], ["c"], "held: there is no scene c"),
        (["a", "a"], [], "posed: .*a: another folder, too, has a scene a"),
        (["a"], ["a"], "held: no scene of posed is left to train"),
        (["b"], [], "posed: in b no two frames share enough of known depth"),
    ):
        folders["posed"] = [tmp_path / "posed" / name for name in posed]
        with pytest.raises(InputError, match=message):
            load_data(**folders, depths=tmp_path, held=held, shares=Shares())
