import subprocess

import dgc_pose
from dgc_pose import version


def test_the_package_has_its_version():
    assert dgc_pose.__version__ == version.version()


def test_a_checkout_has_its_commit_and_whether_files_were_changed(tmp_path, monkeypatch):
    def git(*arguments):
        command = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b.c"]
        return subprocess.check_output([*command, *arguments], text=True).strip()

    git("init", "-q")
    (tmp_path / "file").write_text("1")
    git("add", "file")
    git("commit", "-q", "-m", "first")
    git("tag", "v9")  # a tag does not hide the commit
    commit = version.checked_out(tmp_path)
    assert len(commit) >= 7 and git("rev-parse", "HEAD").startswith(commit)
    (tmp_path / "file").write_text("2")
    assert version.checked_out(tmp_path) == f"{commit}-dirty"
    (tmp_path / "inner").mkdir()  # as site-packages in the environment of another project
    assert version.checked_out(tmp_path / "inner") == "unknown"
    monkeypatch.setenv("PATH", str(tmp_path))  # no git
    assert version.checked_out(tmp_path) == "unknown"
