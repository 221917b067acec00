"""Writes the commit into every build. All other metadata of the package is in setup.cfg."""

import runpy
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

# Run as a file: the package need not be importable where it is built.
VERSION = runpy.run_path(str(Path(__file__).resolve().parent / "dgc_pose" / "version.py"))


def write_build(package: Path) -> None:
    """Write the commit, of the checkout or of the sdist, into a file of the package."""
    package.mkdir(parents=True, exist_ok=True)
    (package / VERSION["BUILD_FILE"]).write_text(VERSION["build"]() + "\n", encoding="utf-8")


class BuildPy(build_py):
    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            write_build(Path(self.build_lib, "dgc_pose"))


class Sdist(sdist):
    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        super().make_release_tree(base_dir, files)
        write_build(Path(base_dir, "dgc_pose"))


setup(cmdclass={"build_py": BuildPy, "sdist": Sdist})
