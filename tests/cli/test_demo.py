import re
import shlex

import numpy as np
from command_line import run

from dgc_pose.cameras.pair_list import bundled_photographs, rendered_pair


def test_demo_prints_both_pairs_with_their_commands_and_the_known_pose(tmp_path):
    result = run("demo", "--plot", tmp_path / "p.png")
    assert result.exit_code == 0
    shown = result.stdout
    assert shown.splitlines()[-6].split() == ["estimated", "known"]
    errors = re.search(r"errors: rotation ([\d.]+) deg, .* ([\d.]+) deg", shown)
    assert float(errors[1]) < 0.5 and float(errors[2]) < 2
    assert (tmp_path / "p.png").stat().st_size > 10_000
    first, second = (shlex.split(line) for line in re.findall("^dgc-pose .*$", shown, re.MULTILINE))
    pair = rendered_pair()
    assert first[2:4] == [str(path) for path in bundled_photographs()]
    assert second[2:4] == [str(pair.path1), str(pair.path2)]
    for flag, camera in zip(("--K1", "--K2"), (pair.camera1, pair.camera2), strict=True):
        fx, fy, cx, cy = map(float, second[second.index(flag) + 1].split(","))
        assert np.array_equal(camera.K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
