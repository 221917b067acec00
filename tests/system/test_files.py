"""Files that are read, and outputs that appear whole; what is no array."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.system.arrays import as_numpy
from dgc_pose.system.files import naming_path, read_text, staged


@pytest.mark.parametrize("value", [np.eye(3) * 1j, "K", None])
def test_what_is_no_array_of_real_numbers_is_refused(value: object) -> None:
    with pytest.raises(InputError, match=r"^K is not an array of real numbers but \w+ of dtype "):
        as_numpy(value, "K")


@pytest.mark.parametrize(
    "content", [b"\0\0\0\x18ftypmp42" + bytes(900), "a.png b.png".encode("utf-16"), b"\xff"]
)
def test_a_file_that_is_no_text_is_told_as_such(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_text(path, "a list of pairs")
    assert str(caught.value) == f"{path} is not text, and a list of pairs is"
    assert caught.value.path == path


def test_outputs_appear_together_at_the_end_or_all_is_as_before(tmp_path):
    """With the rights of any new file, and a link stays a link."""
    (tmp_path / "kept").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "kept")
    first, second = str(tmp_path / "one.txt"), str(tmp_path / "link")
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
    out, missing = str(tmp_path / "a.txt"), str(tmp_path / "nowhere" / "b.txt")
    with pytest.raises(OSError) as caught, staged(out) as stage, naming_path(stage(out)):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.filename == out and caught.value.errno == errno.ENOSPC
    with pytest.raises(OSError) as caught, staged(out, missing):
        pytest.fail("the block must not run")
    assert caught.value.filename == missing
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("paths", [[""], ["."], ["/dev/null"], ["a.txt", "./a.txt"]])
def test_what_is_no_output_is_refused(tmp_path, monkeypatch, paths):
    monkeypatch.chdir(tmp_path)
    with (
        pytest.raises(InputError, match="is a folder or a device|are the same file"),
        staged(*paths),
    ):
        pytest.fail("the block must not run")
