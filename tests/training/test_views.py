"""The truth of coarse levels."""

import torch

from dgc_pose.training.views import level_truth, pixel_grid


def test_level_truth_is_the_map_at_the_cells_centres():
    """Of an affine map, the truth at a level is that map of the cells' centres, exactly."""
    truth = 0.8 * pixel_grid((48, 48), torch.device("cpu"))[None] + 3.0
    for cells in (48, 24, 12, 3):
        stride = 48 // cells
        found, valid = level_truth(truth, torch.ones(1, 48, 48, dtype=torch.bool), cells)
        centres = (torch.arange(cells) + 0.5) * stride - 0.5
        assert valid.all()
        torch.testing.assert_close(found[0, 1, :, 0], 0.8 * centres + 3.0)
        torch.testing.assert_close(found[0, :, 1, 1], 0.8 * centres + 3.0)


def test_level_truth_leaves_out_edges_and_holes():
    truth = pixel_grid((16, 16), torch.device("cpu"))[None]
    valid = torch.ones(1, 16, 16, dtype=torch.bool)
    valid[0, 3, 3] = False
    truth[0, :, 12:] += 50.0  # another surface, whose edge runs between cells
    assert level_truth(truth, valid, 4)[1].all()  # neither is central at stride 4
    _, fine = level_truth(truth, valid, 8)
    assert not fine[0, 1, 1] and int((~fine).sum()) == 1
    truth[0, :, 10:12] += 50.0  # and now through the middle of the cells of 4 pixels
    _, whole = level_truth(truth, valid, 4)
    assert not whole[0, :, 2].any() and whole[0, :, [0, 1, 3]].all()
