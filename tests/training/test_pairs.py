"""Batches of all kinds, the data that they are made of, and warped photographs: one that holds its
own coordinates tells the truth of a map."""

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from rendered import rendered, write_rgbd
from textures import coordinates, drawn_photos, write_photos

from dgc_pose.errors import InputError
from dgc_pose.training import pairs as pairs_module
from dgc_pose.training.draw import Draw
from dgc_pose.training.options import Shares
from dgc_pose.training.pairs import TRAINING, PairSource, load_data, occluded, warped_pairs
from dgc_pose.training.photos import Photos

SHARES = Shares()


def test_a_batch_has_its_shares_and_a_small_one_has_all_kinds_in_turn(monkeypatch):
    made: list[int] = []

    def counted(photos, count, shape, draw, light):
        made.append(count * light)
        return warped_pairs(photos, count, shape, draw, light)

    monkeypatch.setattr(pairs_module, "warped_pairs", counted)
    photos = drawn_photos(2, 16, places=1)
    for count, share, batches in ((25, 0.12, 8), (4, 0.2, 50)):
        source = PairSource(photos, shares=Shares(1 - share, share, 0, 0))
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


def test_shares_are_read_from_percentages():
    assert Shares.parse("50, 0,25,25") == Shares(0.5, 0, 0.25, 0.25)
    for text in ("45,55", "a,b,c,d", "0,0,0,0", "-1,1,1,1", "nan,1,1,1"):
        with pytest.raises(InputError, match="four percentages"):
            Shares.parse(text)


def test_held_scenes_validate_and_the_others_train(tmp_path):
    write_photos(tmp_path / "photos", 40)
    for k, name in enumerate("ab"):
        write_rgbd(tmp_path / "posed" / name, rendered(3 + k, (96, 72)))

    def load(*names, held=(), shares=SHARES):
        posed = [tmp_path / "posed" / name for name in names]
        return load_data(
            tmp_path / "photos", None, posed, depths=tmp_path, held=held, shares=shares
        )

    data = load(".", held=["b"])
    assert list(data) == [TRAINING, "photos", "rooms", "posed"]
    for name, frames in ((TRAINING, {0, 1}), ("posed", {2, 3})):
        assert set(data[name].posed.frames.flatten().tolist()) == frames
    for source in data.values():
        assert source.make(2, (48, 48), Draw("cpu", 0)).valid.any()
    data = load(".", shares=Shares(1, 0, 0, 0))
    assert data[TRAINING].posed is None  # without a share nothing is prepared
    for path in (tmp_path / "posed/b/depth").iterdir():  # b is blind from now on
        cv2.imwrite(str(path), np.zeros((72, 96), np.uint16))
    for names, held, message in (
        (".", ["c"], "held: there is no scene c"),
        ("aa", [], "posed: two folders have a scene a, the second is .*a"),
        ("a", ["a"], "held: all scenes of posed are held back"),
        ("b", [], "posed: no two frames of b share enough pixels"),
    ):
        with pytest.raises(InputError, match=message):
            load(*names, held=held)


@pytest.fixture(scope="module")
def photos():
    """Occluders are of the same blue, and only the half of it in the second of the place."""
    first, second = (coordinates(250, 190, level) for level in (200, 100))
    return Photos.of([first], [[first, second]])


@pytest.mark.parametrize(("shape", "light"), [((96, 96), False), ((64, 160), True)])
def test_both_ends_of_the_map_show_one_point_of_the_photograph(photos, shape, light):
    pairs = warped_pairs(photos, 24, shape, Draw("cpu", "warp", light), light)
    assert pairs.image1.shape == (24, 3, *shape) and pairs.map.isfinite().all()
    assert not (pairs.valid & ~pairs.known).any()
    place = (2 * pairs.map + 1) / pairs.map.new_tensor(shape[::-1]) - 1
    source = F.grid_sample(pairs.image1, place, align_corners=False)
    off = 255 * (source - pairs.image2)[:, :2].abs().amax(1)
    share = pairs.valid.float().mean((1, 2))
    assert 0.3 < share.mean() < 0.9 and share.std() > 0.1
    # Samples between the mirrored edges, and edges of occluders, differ by more.
    assert off[pairs.valid].median() < 0.7 and (off[pairs.valid] < 3).float().mean() > 0.97
    blue = 255 * pairs.image2[:, 2].amax((1, 2))
    assert ((blue - 100).abs() < 2).any() == light


def test_occluders_are_not_visible(photos):
    views = torch.zeros(40, 64, 80, 3)
    shown, hidden = occluded(photos, views, Draw("cpu", 1), share=0.5)
    assert 0.2 < hidden.flatten(1).any(1).float().mean() < 0.8
    assert (shown[hidden][:, 2] > 0.7).all() and (shown[~hidden] == 0).all()
    assert hidden.float().mean((1, 2)).max() < 0.6
