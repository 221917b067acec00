"""Changes of light: blur that moves nothing, noise, and every view for itself."""

import torch
from textures import procedural_textures

from dgc_pose.training.draw import Draw, _kernels, other_light


def test_views_stay_in_range_and_differ_from_each_other():
    images = procedural_textures(1, 48, seed=3).repeat(60, 1, 1, 1)
    changed = other_light(images, Draw("cpu", 0))
    assert changed.shape == images.shape and 0 <= changed.min() and changed.max() <= 1
    assert 0.08 < changed.mean((1, 2, 3)).std() < 0.3
    centred = [(v - v.mean((2, 3), keepdim=True)).mean(1).flatten(1) for v in (changed, images)]
    alike = torch.cosine_similarity(*centred)
    assert alike.median() > 0.75 and alike.min() > 0.2


def test_blurs_keep_the_light_and_the_place():
    kernels = _kernels(400, Draw("cpu", 1)).double()
    axis = torch.arange(-3, 4).double()
    assert (kernels.sum((1, 2)) - 1).abs().max() < 1e-5
    for part in (axis, axis[:, None]):
        assert (kernels * part).sum((1, 2)).abs().max() < 1e-5
    sharp = kernels[:, 3, 3] > 1 - 1e-9
    assert 0.5 < sharp.float().mean() < 0.66
