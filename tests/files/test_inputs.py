import pytest

from dgc_pose.files.inputs import read_start


def test_an_error_of_the_reading_names_the_file() -> None:
    """A fault that root meets too: the memory begins with a page that is not there."""
    with pytest.raises(OSError, match="Input/output error: '/proc/self/mem'"):
        read_start("/proc/self/mem", 8)
