import re
import shlex

import numpy as np
from command_line import run

from dgc_pose.cameras.pair_list import rendered_pair
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.images.image import load_image
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.metrics import rotation_error_deg, translation_error_deg


def test_the_known_pose_is_that_of_the_pictures():
    pair = rendered_pair()
    matches = SiftMatcher().match(load_image(pair.path1), load_image(pair.path2)).matches
    pose = estimate_pose(matches, pair.camera1, pair.camera2, EstimationOptions())
    assert pose.success
    assert rotation_error_deg(pose.R, pair.R) < 0.5
    assert translation_error_deg(pose.t, pair.t) < 2


def test_demo_prints_the_estimate_the_known_pose_and_a_command_that_does_the_same(tmp_path):
    options = ("--weights", "sift", "--runs", "2", "--effort", "fast")
    result = run("demo", *options, "--plot", tmp_path / "p.png")
    assert result.exit_code == 0
    shown = result.stdout
    assert shown.splitlines()[-6].split() == ["estimated", "known"]
    errors = re.search(r"errors: rotation ([\d.]+) deg, .* ([\d.]+) deg", shown)
    assert float(errors[1]) < 5 and float(errors[2]) < 15
    assert (tmp_path / "p.png").stat().st_size > 10_000
    pair = rendered_pair()
    cameras = re.findall(r"^image \d: (.*), K (.*)$", shown, re.MULTILINE)
    for (path, K), expected, camera in zip(
        cameras, (pair.path1, pair.path2), (pair.camera1, pair.camera2), strict=True
    ):
        assert path == str(expected)
        fx, fy, cx, cy = map(float, K.split(","))
        assert np.array_equal(camera.K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    (command,) = re.findall(r"^the same by: dgc-pose (.*)$", shown, re.MULTILINE)
    words = shlex.split(command)
    assert sorted(words[7:]) == sorted(options)
    again = run(*words)
    assert again.exit_code == 0
    *pose, times = again.stdout.splitlines()
    assert "\n".join(pose) in shown and times.startswith("load ")
