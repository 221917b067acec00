"""The version of dgc-pose, and the commit that it was built from."""

import subprocess
from importlib import metadata
from pathlib import Path

BUILD_FILE = "build.txt"  # in the package; setup.py writes it into every wheel and sdist
UNKNOWN = "unknown"


def version() -> str:
    """The version of the installed distribution, by the rules of semantic versioning."""
    return metadata.version("dgc-pose")


def build() -> str:
    """The commit that the package was built from, with "-dirty" if files had been changed.

    For an editable installation, the commit that is checked out. "unknown" for a build outside of a
    git repository.
    """
    package = Path(__file__).resolve().parent
    file = package / BUILD_FILE
    if file.is_file():
        return file.read_text(encoding="utf-8").strip() or UNKNOWN
    return checked_out(package.parent)


def checked_out(folder: Path) -> str:
    """The commit of the git checkout whose top folder this is, or "unknown"."""
    if not (folder / ".git").exists():
        return UNKNOWN
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return UNKNOWN
