import hashlib
import os
import sys
from importlib import metadata
from pathlib import Path

from command_line import run
from hidden_packages import run_in, without

import dgc_pose
from dgc_pose.cli.info import _facts


def test_the_facts_are_those_of_the_installation(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    facts = _facts()
    assert facts["dgc-pose"]["version"] == metadata.version("dgc-pose")
    assert facts["libraries"]["numpy"] == metadata.version("numpy")
    assert facts["environment"]["OMP_NUM_THREADS"] == "3"
    files = [*(Path(dgc_pose.__file__).parent / "weights").glob("*.safetensors")]
    assert files and set(facts["weights"]) == {file.name for file in files}
    for file in files:
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        assert facts["weights"][file.name].endswith(f"sha256 {digest[:16]}")
    text = run("info").stdout
    for heading, group in facts.items():
        assert heading in text.splitlines()
        for name, value in group.items():
            assert f"  {name} " in text and value in text


def test_torch_may_be_missing(tmp_path):
    environment = without(tmp_path, "torch")
    environment["PYTHONPATH"] += os.pathsep + os.pathsep.join(sys.path)
    done = run_in(environment, "info")
    assert done.returncode == 0, done.stderr
    lines = [line.split(maxsplit=1) for line in done.stdout.splitlines()]
    assert lines.count(["torch", "not installed"]) == 1  # of the devices: it is there, but hidden
