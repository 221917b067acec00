"""Commands in processes that lack packages, as after an installation without some extras."""

import os
import subprocess
import sys
from pathlib import Path

# Read by each Python process that starts, also by the workers of a command.
_SITE = """
import os, sys
from importlib.machinery import PathFinder

class Finder(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        hidden = name.split(".")[0] in os.environ["HIDDEN_PACKAGES"].split(",")
        return None if hidden else super().find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Finder
"""
EXTRAS = ("torch", "scipy", "sklearn", "ray", "starlette", "uvicorn", "pillow_heif")


def without(folder: Path, *packages: str) -> dict[str, str]:
    """The environment of processes that lack these packages; a file of it lies in `folder`."""
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(_SITE)
    return os.environ | {"PYTHONPATH": str(folder), "HIDDEN_PACKAGES": ",".join(packages)}


def run_in(environment: dict[str, str], *words: object) -> subprocess.CompletedProcess[str]:
    """`dgc-pose WORDS` in a process of its own, in the folder /."""
    command = [sys.executable, "-m", "dgc_pose", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, cwd="/")
