import errno
import os

import pytest

from dgc_pose.errors import InputError
from dgc_pose.files.outputs import staged, writing


def test_outputs_appear_together_at_the_end(tmp_path):
    first, second = str(tmp_path / "one.txt"), str(tmp_path / "two.txt")
    with staged(first, None, second) as stage:
        stage(first).write_text("1")
        stage(second).write_text("2")
        assert not os.path.exists(first) and not os.path.exists(second)
    assert sorted(os.listdir(tmp_path)) == ["one.txt", "two.txt"]
    assert (tmp_path / "one.txt").read_text() == "1"
    assert (tmp_path / "two.txt").read_text() == "2"


def test_after_an_exception_all_is_as_before(tmp_path):
    kept = tmp_path / "kept.txt"
    kept.write_text("old")
    with pytest.raises(RuntimeError), staged(str(kept), str(tmp_path / "new.txt")) as stage:
        stage(str(kept)).write_text("half")
        raise RuntimeError
    assert os.listdir(tmp_path) == ["kept.txt"]
    assert kept.read_text() == "old"


def test_an_error_of_the_writing_has_the_outputs_name(tmp_path):
    out = str(tmp_path / "a.txt")
    with pytest.raises(OSError) as caught, staged(out) as stage, writing(stage(out)):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.filename == out and caught.value.errno == errno.ENOSPC


def test_an_output_that_cannot_be_written_leaves_nothing(tmp_path):
    missing = str(tmp_path / "nowhere" / "b.txt")
    with pytest.raises(OSError) as caught, staged(str(tmp_path / "a.txt"), missing):
        pytest.fail("the block must not run")
    assert caught.value.filename == missing
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("path", ["", ".", "/dev/null"])
def test_a_folder_or_a_device_is_no_output(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="must be a file"), staged(path):
        pytest.fail("the block must not run")


def test_two_outputs_in_one_file_are_refused(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "a.txt")
    with pytest.raises(InputError), staged(str(tmp_path / "a.txt"), str(tmp_path / "link")):
        pytest.fail("the block must not run")


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "a.txt")
    with staged(str(tmp_path / "link")) as stage:
        stage(str(tmp_path / "link")).write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "a.txt").read_text() == "new"


def test_outputs_have_the_rights_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_text("")
    with staged(str(tmp_path / "a.txt")) as stage:
        stage(str(tmp_path / "a.txt")).write_text("1")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain").stat().st_mode
