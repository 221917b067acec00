import hashlib
import json
import sys
from importlib import metadata
from pathlib import Path

import cv2
import pytest
from click.testing import CliRunner

import dgc_pose
import dgc_pose.cli
from dgc_pose.cli.main import main
from dgc_pose.system import environment


@pytest.fixture(scope="module")
def facts():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMP_NUM_THREADS", "3")
        result = CliRunner().invoke(main, ["info", "--json"])
        assert result.exit_code == 0
        yield json.loads(result.stdout)


def test_the_facts_are_those_of_the_installation(facts):
    assert facts["dgc-pose"]["version"] == metadata.version("dgc-pose")
    assert facts["libraries"]["numpy"] == metadata.version("numpy")
    assert facts["machine"]["Python"].startswith(sys.version.split()[0])
    assert facts["devices"]["runtime"] in ("onnx", "torch")
    assert facts["threads"]["OpenCV"] == str(cv2.getNumThreads())
    assert facts["environment"]["OMP_NUM_THREADS"] == "3"
    files = [*(Path(dgc_pose.__file__).parent / "weights").glob("*.safetensors")]
    assert files and set(facts["weights"]) == {file.name for file in files}
    for file in files:
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        assert facts["weights"][file.name].endswith(f"sha256 {digest[:16]}")


def test_the_text_has_all_facts(facts):
    text = CliRunner().invoke(main, ["info"]).stdout
    for heading, group in facts.items():
        assert heading in text.splitlines()
        for name, value in group.items():
            assert f"  {name} " in text and value in text


def test_what_is_not_installed_is_said(monkeypatch):
    monkeypatch.setattr(environment, "is_installed", lambda module: False)
    monkeypatch.setattr(environment, "LIBRARIES", ("numpy", "no-such-library"))
    found = environment.environment()
    assert found["devices"] == {"torch": "not installed"}
    assert found["libraries"]["no-such-library"] == "not installed"
