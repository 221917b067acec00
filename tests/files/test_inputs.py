from pathlib import Path

import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.files.arrays import as_numpy
from dgc_pose.files.inputs import TEXT_BYTES, read_start, read_text


def test_an_error_of_the_reading_names_the_file() -> None:
    """A fault that root meets too: the memory begins with a page that is not there."""
    with pytest.raises(OSError, match="Input/output error: '/proc/self/mem'"):
        read_start("/proc/self/mem", 8)


@pytest.mark.parametrize("value", [np.eye(3) * 1j, "K", None])
def test_what_is_no_array_of_real_numbers_is_refused(value: object) -> None:
    with pytest.raises(InputError, match=r"^K is not an array of real numbers but \w+ of dtype "):
        as_numpy(value, "K")


VIDEO = b"\0\0\0\x18ftypmp42"


@pytest.mark.parametrize(
    ("content", "size"),
    [(VIDEO, 1000), (VIDEO, TEXT_BYTES + 1), ("a.png b.png".encode("utf-16"), 24), (b"\xff", 1)],
)
def test_a_file_that_is_no_text_is_told_as_such(tmp_path: Path, content: bytes, size: int) -> None:
    """Also one of more bytes than a text may have."""
    path = tmp_path / "x.mp4"
    path.write_bytes(content)
    with path.open("r+b") as stream:
        stream.truncate(size)
    with pytest.raises(InputError) as caught:
        read_text(path, "a list of pairs")
    assert str(caught.value) == f"{path} is not text, and a list of pairs is"
