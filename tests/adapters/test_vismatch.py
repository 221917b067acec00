"""vismatch's class."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from multi_view import render_views

from dgc_pose.image import Image
from dgc_pose.matchers import load_matcher


def test_the_real_base_class_runs_it() -> None:
    """Matches are those of the matcher alone, and vismatch's own inliers follow."""
    pytest.importorskip("vismatch", exc_type=ImportError)
    from dgc_pose.adapters.vismatch import DgcPoseMatcher

    pixels = [view.pixels for view in render_views(2)]
    tensors = [torch.from_numpy(one).permute(2, 0, 1).float() / 255 for one in pixels]
    found = DgcPoseMatcher(matcher=load_matcher("sift"), ransac_iters=500)(*tensors)
    expected = load_matcher("sift").match(*map(Image, pixels)).matches
    np.testing.assert_allclose(found["matched_kpts0"], expected.points1)
    np.testing.assert_allclose(found["matched_kpts1"], expected.points2)
    np.testing.assert_allclose(found["matched_confidences"], expected.confidence)
    assert found["num_inliers"] == len(found["inlier_kpts0"]) > 20
    black = torch.zeros(3, 20, 20)
    assert DgcPoseMatcher(matcher=load_matcher("sift"))(black, black)["num_inliers"] == 0
