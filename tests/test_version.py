import subprocess

import pytest

import dgc_pose
from dgc_pose import version


def test_the_package_has_its_version():
    assert dgc_pose.__version__ == version.version()
    assert "__version__" in dir(dgc_pose)
    with pytest.raises(AttributeError, match="__author__"):
        _ = dgc_pose.__author__


@pytest.fixture
def checkout(tmp_path):
    """A git repository with one commit; returns its folder."""

    def git(*arguments):
        subprocess.run(["git", "-C", str(tmp_path), *arguments], check=True, capture_output=True)

    git("init", "-q")
    (tmp_path / "file").write_text("1")
    git("add", "file")
    who = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    git(*who, "commit", "-q", "-m", "first")
    git("tag", "v9")  # a tag does not hide the commit
    return tmp_path


def test_a_checkout_has_its_commit_and_whether_files_were_changed(checkout):
    command = ["git", "-C", str(checkout), "rev-parse", "HEAD"]
    commit = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    found = version.checked_out(checkout)
    assert len(found) >= 7 and commit.startswith(found)
    (checkout / "file").write_text("2")
    assert version.checked_out(checkout) == f"{found}-dirty"


def test_another_folder_or_no_git_is_no_checkout(checkout, monkeypatch):
    """A folder within, as site-packages in the virtual environment of another project."""
    (checkout / "inner").mkdir()
    assert version.checked_out(checkout / "inner") == "unknown"
    monkeypatch.setenv("PATH", str(checkout))
    assert version.checked_out(checkout) == "unknown"
