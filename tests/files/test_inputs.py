from pathlib import Path

import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.files.arrays import as_numpy
from dgc_pose.files.inputs import read_text


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
