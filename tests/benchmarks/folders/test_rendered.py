"""Rendered folders: the truth of their views, and that a place is there twice."""

from itertools import permutations, product

import numpy as np
import pytest
import torch
from textures import drawn_photos

from dgc_pose.benchmarks.folders import KINDS, _copied, _Maker, rendered_folder
from dgc_pose.training.views import about_axis, pixel_grid

SHAPE = (36, 48)


@pytest.fixture(scope="module")
def folders():
    photos = drawn_photos(9, 64)
    return {kind: rendered_folder(kind, photos, 0, SHAPE) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_a_point_has_its_depth_in_every_view_that_sees_it(folders, kind):
    """Where something hides it, it is farther than what is seen; nowhere is it nearer."""
    views, ratios, shares = folders[kind].values(), [], []
    assert 12 <= len(views) <= 15
    assert {view.part for view in views} == ({"A", "B"} if kind == "rooms" else {"A"})
    pixels = pixel_grid(SHAPE, torch.device("cpu")).flatten(0, 1)[None]
    for view, other in permutations([view for view in views if view.part == "A"], 2):
        place = view.camera.unproject(pixels, torch.from_numpy(view.depth).flatten()[None])
        found, depth = (values[0].numpy() for values in other.camera.project(place))
        columns, rows = np.rint(found).astype(int).T
        inside = (depth > 0.05) & (columns >= 1) & (columns < SHAPE[1] - 1)
        inside &= (rows >= 1) & (rows < SHAPE[0] - 1)
        steps = product((-1, 0, 1), repeat=2)
        around = [other.depth[rows[inside] + dy, columns[inside] + dx] for dy, dx in steps]
        ratios.append(depth[inside] / np.min(around, 0))
        seen = np.isclose(around[4], depth[inside], rtol=0.02)
        shares.append(seen.sum() / len(depth))
    assert (np.concatenate(ratios) > 0.98).mean() > 0.99
    assert max(shares) > 0.5  # of two views beside each other


def test_the_same_seed_gives_the_same_folder_and_another_one_another(folders):
    photos = drawn_photos(9, 64)
    again, other = (rendered_folder("object", photos, seed, SHAPE) for seed in (0, 1))
    assert all(np.array_equal(again[n].image, view.image) for n, view in folders["object"].items())
    assert any(not np.array_equal(other[n].image, again[n].image) for n in again)


def test_a_copy_is_turned_then_shifted_and_looks_the_same():
    make = _Maker(np.random.default_rng(1))
    (box,) = make.boxes(1, (0.2, 0.5), ((1, 0, 2), (2, 0, 3)), 1.0)
    (copy,) = _copied([box], shift=(1, 2, 3), turn=0.7)
    assert copy.seed == box.seed and copy.yaw == pytest.approx(box.yaw + 0.7)
    turn = about_axis(torch.tensor(0.7), 1).numpy()  # as the box's own axes are turned
    np.testing.assert_allclose(copy.centre, turn @ box.centre + (1, 2, 3), rtol=1e-6)


def test_what_is_repeated_shares_its_textures_and_nothing_else_does():
    make = _Maker(np.random.default_rng(2))
    first, second = ({box.seed for box in boxes} for boxes, _, _ in make.rooms())
    assert len(first & second) == 5 and len(first) == len(second) == 12
    for kind, copies in (("object", 2), ("tower", 4), ("shelf", 5)):
        ((boxes, _, _),) = getattr(make, kind)()
        _, counts = np.unique([box.seed for box in boxes], return_counts=True)
        assert counts.max() == copies and (counts == 1).sum() > 8
