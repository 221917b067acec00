"""The bundled pair has one pose on all processors and by both runtimes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from dgc_pose.metrics import rotation_error_deg, translation_error_deg

TOLERANCE_DEG = 0.01  # as README.md states
# The variables that turn libraries down to AVX2, one a line; `make test-processors` sets them too.
AVX2 = dict(
    line.split("=", 1)
    for line in (Path(__file__).parents[1] / "avx2.env").read_text(encoding="utf-8").split()
)
pytestmark = pytest.mark.slow

_POSE = """
import json, sys
from dgc_pose import load_matcher
from dgc_pose.cameras.pair_list import rendered_pair
from dgc_pose.images.image import load_image
from dgc_pose.pose import estimate_relative_pose
pair = rendered_pair()
images = load_image(pair.path1), load_image(pair.path2)
matcher = load_matcher(device="cpu", runtime=sys.argv[1])
pose = estimate_relative_pose(*images, pair.camera1, pair.camera2, matcher=matcher)
print(json.dumps([pose.R.tolist(), pose.t.tolist()]))
"""
Pose = tuple[np.ndarray, np.ndarray]


def _pose(variables: dict[str, str], runtime: str = "auto") -> Pose:
    """R and t of the bundled pair by a process of its own, with these variables besides."""
    inherited = {key: value for key, value in os.environ.items() if key not in AVX2}
    done = subprocess.run(
        [sys.executable, "-c", _POSE, runtime],
        env=inherited | variables,
        capture_output=True,
        text=True,
        check=True,
    )
    R, t = json.loads(done.stdout)
    return np.array(R), np.array(t)


def _apart_deg(one: Pose, other: Pose) -> float:
    return max(rotation_error_deg(one[0], other[0]), translation_error_deg(one[1], other[1]))


@pytest.fixture(scope="module")
def here():
    """By the default runtime, with all that the processor has."""
    return _pose({})


def test_the_runtimes_give_the_same_pose(here):
    assert _apart_deg(here, _pose({}, runtime="torch")) < TOLERANCE_DEG


@pytest.mark.skipif(
    torch.backends.cpu.get_cpu_capability() not in ("AVX2", "AVX512"),
    reason="the processor has no AVX2",
)
@pytest.mark.parametrize("runtime", ["auto", "torch"])
def test_a_processor_without_avx512_gives_the_same_pose(here, runtime):
    assert _apart_deg(here, _pose(AVX2, runtime=runtime)) < TOLERANCE_DEG
