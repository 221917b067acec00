from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from dgc_pose.cli.main import SUBCOMMANDS, main


def completed(words, incomplete):
    shell = ShellComplete(main, {}, "dgc-pose", "_DGC_POSE_COMPLETE")
    return [(item.type, item.value) for item in shell.get_completions(words, incomplete)]


def test_commands_are_completed_without_being_imported(monkeypatch):
    monkeypatch.setattr("importlib.import_module", None)
    assert [value for _, value in completed([], "")] == [*SUBCOMMANDS]
    assert completed([], "esti") == [("plain", "estimate")]


def test_options_and_their_choices_are_completed():
    assert ("plain", "--runtime") in completed(["estimate"], "--runt")
    assert completed(["estimate", "--runtime"], "onn") == [("plain", "onnx")]


@pytest.mark.parametrize("words", [["estimate"], ["match", "a.png"], ["estimate", "--plot"]])
def test_files_are_left_to_the_shell(words):
    assert [kind for kind, _ in completed(words, "a")] == ["file"]


def test_folders_are_left_to_the_shell():
    assert [kind for kind, _ in completed(["bench-dtu", "--out"], "a")] == ["dir"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_scripts_of_the_shells_are_sound(shell):
    result = CliRunner().invoke(main, ["completion", shell])
    assert result.exit_code == 0
    assert "_DGC_POSE_COMPLETE" in result.stdout and "dgc-pose" in result.stdout
    executable = shutil.which(shell)
    if executable is not None:
        subprocess.run([executable, "-n"], input=result.stdout, text=True, check=True)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
def test_bash_completes_by_the_script(tmp_path):
    script = CliRunner().invoke(main, ["completion", "bash"]).stdout
    command = tmp_path / "dgc-pose"
    command.write_text(
        f"#!{sys.executable}\nfrom dgc_pose.cli.main import main\nmain(prog_name='dgc-pose')\n"
    )
    command.chmod(0o755)
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


def test_another_shell_is_refused():
    result = CliRunner().invoke(main, ["completion", "tcsh"])
    assert result.exit_code == 2 and "tcsh" in result.stderr
