"""What the commands print of a pose."""

from dataclasses import replace

import pytest

from dgc_pose.cli.output import pose_text
from dgc_pose.estimation import EstimationOptions, estimate_pose
from two_view import two_view_scene


@pytest.mark.parametrize(
    ("probability", "words"),
    [(1.0, "over 99 %"), (0.9949, "99 %"), (0.874, "87 %"), (0.01, "1 %"), (0.0, "below 1 %")],
)
def test_no_probability_is_printed_as_certain(probability, words) -> None:
    scene = two_view_scene("general", seed=0, count=200)
    pose = estimate_pose(scene.matches, *scene.cameras, EstimationOptions(runs=1))
    lines = pose_text(replace(pose, probability=probability)).splitlines()
    assert f"probability {words} that R and t are within 10 deg" in lines
