"""Outputs that appear whole."""

import errno
import os

import pytest

from dgc_pose.errors import InputError
from dgc_pose.system.files import naming_path, staged


def test_outputs_appear_together_at_the_end_or_all_is_as_before(tmp_path):
    """With the rights of any new file, and a link stays a link."""
    (tmp_path / "kept").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "kept")
    first = str(tmp_path / "one.txt")
    second = str(tmp_path / "link")
    with pytest.raises(RuntimeError), staged(first, second) as stage:
        stage(second).write_text("half")
        raise RuntimeError
    assert sorted(os.listdir(tmp_path)) == ["kept", "link"]
    assert (tmp_path / "kept").read_text() == "old"
    with staged(first, None, second) as stage:
        stage(first).write_text("1")
        stage(second).write_text("2")
        assert not os.path.exists(first)
    assert sorted(os.listdir(tmp_path)) == ["kept", "link", "one.txt"]
    assert (tmp_path / "link").is_symlink() and (tmp_path / "kept").read_text() == "2"
    assert os.stat(first).st_mode == os.stat(tmp_path / "kept").st_mode


def test_errors_of_the_writing_have_the_outputs_name(tmp_path):
    out = str(tmp_path / "a.txt")
    missing = str(tmp_path / "nowhere" / "b.txt")
    with pytest.raises(OSError) as caught, staged(out) as stage, naming_path(stage(out)):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.filename == out and caught.value.errno == errno.ENOSPC
    with pytest.raises(OSError) as caught, staged(out, missing):
        pytest.fail("the block must not run")
    assert caught.value.filename == missing
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("paths", [[""], ["."], ["/dev/null"], ["a.txt", "./a.txt"]])
def test_a_folder_a_device_or_one_file_twice_is_refused_as_output(tmp_path, monkeypatch, paths):
    monkeypatch.chdir(tmp_path)
    with (
        pytest.raises(InputError, match="is a folder or a device|are the same file"),
        staged(*paths),
    ):
        pytest.fail("the block must not run")
