"""click's own completion: `eval "$(_DGC_POSE_COMPLETE=bash_source dgc-pose)"`."""

import os
import shutil
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete

from dgc_pose.cli.main import SUBCOMMANDS, main


def completed(words, incomplete):
    shell = ShellComplete(main, {}, "dgc-pose", "_DGC_POSE_COMPLETE")
    return [(item.type, item.value) for item in shell.get_completions(words, incomplete)]


def test_commands_are_completed_without_being_imported(monkeypatch):
    monkeypatch.setattr("importlib.import_module", None)
    assert [value for _, value in completed([], "")] == [*SUBCOMMANDS]
    assert completed([], "esti") == [("plain", "estimate")]


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
def test_bash_completes(tmp_path):
    command = tmp_path / "dgc-pose"
    command.write_text(
        f"#!{sys.executable}\nfrom dgc_pose.cli.main import main\nmain(prog_name='dgc-pose')\n"
    )
    command.chmod(0o755)
    script = 'eval "$(_DGC_POSE_COMPLETE=bash_source dgc-pose)"'
    ask = "COMP_WORDS=(dgc-pose bench-sp); COMP_CWORD=1; _dgc_pose_completion dgc-pose"
    environment = os.environ | {
        "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    result = subprocess.run(
        ["bash", "-c", f"{script}\n{ask}\necho ${{COMPREPLY[@]}}"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.split() == ["bench-speed"]
