"""vismatch's class: by the real package where it installs, else by a stand-in of its contract."""

import importlib
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from multi_view import render_views

from dgc_pose.images.image import Image
from dgc_pose.matchers import load_matcher


class _StandIn(torch.nn.Module):
    """What vismatch 1.4's BaseMatcher does with `_forward`, without its RANSAC."""

    def __init__(self, device: str = "cpu", **kwargs: Any) -> None:
        super().__init__()
        self.device = device
        self.ransac_iters = kwargs.get("ransac_iters", 2000)

    @torch.inference_mode()
    def forward(self, img0: torch.Tensor, img1: torch.Tensor) -> dict[str, Any]:
        points0, points1, all0, all1, described0, described1, confidence = self._forward(img0, img1)
        assert all(part is None for part in (all0, all1, described0, described1))
        assert points0.shape == points1.shape == (len(confidence), 2)
        return {
            "matched_kpts0": points0,
            "matched_kpts1": points1,
            "matched_confidences": confidence,
        }


@pytest.fixture
def matcher_class(monkeypatch: pytest.MonkeyPatch) -> Iterator[type]:
    """`DgcPoseMatcher`, imported for this test alone."""
    try:
        importlib.import_module("vismatch")
    except (ImportError, RuntimeError):  # also if its torchvision is for another torch
        module = ModuleType("vismatch")
        module.BaseMatcher = _StandIn  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "vismatch", module)
    yield importlib.import_module("dgc_pose.adapters.vismatch").DgcPoseMatcher
    sys.modules.pop("dgc_pose.adapters.vismatch")


def test_matches_are_those_of_the_matcher_alone(matcher_class: type) -> None:
    pixels = [view.pixels for view in render_views(2)]
    tensors = [torch.from_numpy(view).permute(2, 0, 1).float() / 255 for view in pixels]
    matcher = matcher_class(matcher=load_matcher("sift"), ransac_iters=500)
    assert matcher.ransac_iters == 500
    result = matcher(*tensors)
    expected = load_matcher("sift").match(*map(Image, pixels)).matches
    assert len(expected) > 100
    np.testing.assert_allclose(result["matched_kpts0"], expected.points1)
    np.testing.assert_allclose(result["matched_kpts1"], expected.points2)
    np.testing.assert_allclose(result["matched_confidences"], expected.confidence)
