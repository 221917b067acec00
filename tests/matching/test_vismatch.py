"""Matchers of vismatch: by the real package where it installs, else by a stand-in."""

import importlib
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from worlds import render_views

from dgc_pose import load_matcher
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image


class _Dots:
    """As vismatch 1.4's orb-nn answers: every key point, and no confidence. Here they are the
    brightest pixels of each row of the images."""

    skip_ransac = False

    def __call__(self, img0: torch.Tensor, img1: torch.Tensor) -> dict[str, Any]:
        assert self.skip_ransac
        print("what is printed does not reach the standard output")
        keys = []
        for planes in (img0, img1):
            assert planes.dtype == torch.float32 and planes.shape[0] == 3 and planes.max() <= 1
            if planes.max() == 0:
                raise ValueError("no descriptors")
            x = planes.sum(0).argmax(1).numpy().astype(np.float32)
            keys.append(np.stack([x, np.arange(len(x), dtype=np.float32)], -1))
        matched = {f"matched_kpts{k}": keys[k][: min(map(len, keys))] for k in (0, 1)}
        return matched | {"all_kpts0": keys[0], "matched_confidences": None}


def _get_matcher(name: str, device: str) -> _Dots:
    assert device == "cpu"
    return _Dots()


@pytest.fixture
def vismatch(monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        importlib.import_module("vismatch")
    except (ImportError, RuntimeError):  # also if its torchvision is for another torch
        module = ModuleType("vismatch")
        module.available_models = ["loftr", "orb-nn"]  # type: ignore[attr-defined]
        module.get_matcher = _get_matcher  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "vismatch", module)


@pytest.mark.usefixtures("vismatch")
def test_matches_of_vismatch_are_ours(capsys: pytest.CaptureFixture[str]) -> None:
    images = [Image(view.pixels) for view in render_views(2)]
    matcher = load_matcher("vismatch:orb-nn", device="cpu")
    matches = matcher.match(images[0], images[1]).matches
    assert matcher.name == "vismatch:orb-nn" and matcher.fingerprint is None
    assert len(matches) > 100 and matches.key_points and matches.error_px == 1.0
    assert (matches.confidence == 1).all()
    assert capsys.readouterr().out == ""
    with pytest.raises(InputError, match="vismatch:orb-nn failed on the pair"):
        matcher.match(images[0], Image(np.zeros((40, 40, 3), np.uint8)))
    with pytest.raises(InputError, match="vismatch has no nothing; choose one of .*orb-nn"):
        load_matcher("vismatch:nothing")


def test_without_vismatch_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "vismatch", None)
    with pytest.raises(InputError, match="vismatch:orb-nn needs `pip install vismatch`"):
        load_matcher("vismatch:orb-nn")
