import re

import pytest
from command_line import assert_refused, run

from dgc_pose.cameras.pair_list import bundled_pair
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.images.image import load_image
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.metrics import rotation_error_deg, translation_error_deg


def test_the_known_pose_is_that_of_the_pictures():
    pair = bundled_pair()
    matches = SiftMatcher().match(load_image(pair.path1), load_image(pair.path2)).matches
    pose = estimate_pose(matches, pair.camera1, pair.camera2, EstimationOptions())
    assert pose.success
    assert rotation_error_deg(pose.R, pair.R) < 0.5
    assert translation_error_deg(pose.t, pair.t) < 2


def test_demo_prints_the_estimate_beside_the_known_pose(tmp_path):
    result = run("demo", "--plot", tmp_path / "p.png")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[-6].split() == ["estimated", "known"]
    errors = re.search(r"errors: rotation ([\d.]+) deg, .* ([\d.]+) deg", result.stdout)
    assert errors is not None
    assert float(errors[1]) < 5 and float(errors[2]) < 15
    assert (tmp_path / "p.png").stat().st_size > 10_000


@pytest.mark.parametrize("option", [("--weights", "nosuch.pth"), ("--plot", "p.docx")])
def test_unusable_options_are_refused(option):
    assert_refused(run("demo", *option), option[1])
