"""The call of kornia's LoFTR."""

import numpy as np
import pytest
import torch
from multi_view import SIZE, render_views
from torch import Tensor

from dgc_pose.adapters.kornia import LoFTRShape
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.matchers import load_matcher


def _grey(pixels: np.ndarray) -> Tensor:
    """(1, 1, H, W) in [0, 1]."""
    return torch.from_numpy(pixels.mean(-1)).float()[None, None] / 255


@pytest.fixture(scope="module")
def output() -> dict[str, Tensor]:
    """Of two pairs in one batch."""
    views = [_grey(view.pixels) for view in render_views(3)]
    module = LoFTRShape(load_matcher("sift"))
    return module({"image0": torch.cat(views[:2]), "image1": torch.cat(views[1:])})


def test_the_batch_is_that_of_single_pairs(output: dict[str, Tensor]) -> None:
    views = [_grey(view.pixels) for view in render_views(3)]
    for i in range(2):
        of = output["batch_indexes"] == i
        grey = [np.rint(views[i + k][0, 0].numpy() * 255).astype(np.uint8) for k in (0, 1)]
        images = [Image(np.repeat(pixels[..., None], 3, -1)) for pixels in grey]
        expected = load_matcher("sift").match(*images).matches
        np.testing.assert_allclose(output["keypoints0"][of], expected.points1, rtol=1e-6)
        np.testing.assert_allclose(output["keypoints1"][of], expected.points2, rtol=1e-6)
        np.testing.assert_allclose(output["confidence"][of], expected.confidence, rtol=1e-5)
    assert (output["keypoints0"].max(0).values < torch.tensor(SIZE)).all()


def test_the_output_is_that_of_kornias_loftr(output: dict[str, Tensor]) -> None:
    """The same keys, dimensions and types as of the real class, without its weights; and kornia's
    own estimate takes the points."""
    kornia = pytest.importorskip("kornia")
    noise = torch.rand(1, 1, 64, 64, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        theirs = kornia.feature.LoFTR(pretrained=None).eval()({"image0": noise, "image1": noise})
    assert output.keys() == theirs.keys()
    for key, value in theirs.items():
        assert output[key].ndim == value.ndim, key
        assert output[key].dtype == value.dtype, key
    first = output["batch_indexes"] == 0
    points = [output[f"keypoints{k}"][first][None] for k in (0, 1)]
    F = kornia.geometry.epipolar.find_fundamental(*points, torch.ones(points[0].shape[:2]))
    distance = kornia.geometry.epipolar.sampson_epipolar_distance(*points, F)
    assert float(distance.median()) < 1


def test_other_shapes_are_refused() -> None:
    module = LoFTRShape(load_matcher("sift"))
    good = torch.zeros(1, 1, 20, 20)
    for bad in (torch.zeros(20, 20), torch.zeros(2, 1, 20, 20)):
        with pytest.raises(InputError, match="image0 and image1"):
            module({"image0": good, "image1": bad})
    with pytest.raises(InputError, match=r"image1\[0\]"):
        module({"image0": good, "image1": torch.zeros(1, 2, 20, 20)})
    with pytest.raises(InputError, match="not finite"):
        module({"image0": good, "image1": good * torch.nan})
    assert len(module({"image0": good, "image1": good})["keypoints0"]) == 0
