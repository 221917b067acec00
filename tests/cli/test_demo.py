import re
import shlex

import numpy as np
from command_line import run

from dgc_pose.cameras.pair_list import bundled_photographs, rendered_pair
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


def test_demo_prints_both_pairs_with_commands_that_do_the_same_and_the_known_pose(tmp_path):
    options = ("--weights", "sift", "--runs", "2", "--effort", "fast")
    result = run("demo", *options, "--plot", tmp_path / "p.png")
    assert result.exit_code == 0
    shown = result.stdout
    assert shown.splitlines()[-6].split() == ["estimated", "known"]
    errors = re.search(r"errors: rotation ([\d.]+) deg, .* ([\d.]+) deg", shown)
    assert float(errors[1]) < 5 and float(errors[2]) < 15
    assert (tmp_path / "p.png").stat().st_size > 10_000
    commands = re.findall(r"^dgc-pose (.*)$", shown, re.MULTILINE)
    for command, paths in zip(commands, (bundled_photographs(), rendered_paths()), strict=True):
        words = shlex.split(command)
        assert words[1:3] == [str(path) for path in paths]
        again = run(*words)
        assert again.exit_code == 0
        *pose, times = again.stdout.splitlines()
        assert "\n".join(pose) in shown and times.startswith("load ")
    words = shlex.split(commands[1])
    cameras = rendered_pair().camera1, rendered_pair().camera2
    for flag, camera in zip(("--K1", "--K2"), cameras, strict=True):
        fx, fy, cx, cy = map(float, words[words.index(flag) + 1].split(","))
        assert np.array_equal(camera.K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def rendered_paths():
    return rendered_pair().path1, rendered_pair().path2
