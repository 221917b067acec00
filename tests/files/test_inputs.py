import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.files.arrays import as_numpy
from dgc_pose.files.inputs import read_start


def test_an_error_of_the_reading_names_the_file() -> None:
    """A fault that root meets too: the memory begins with a page that is not there."""
    with pytest.raises(OSError, match="Input/output error: '/proc/self/mem'"):
        read_start("/proc/self/mem", 8)


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (np.eye(3) * 1j, "ndarray of dtype complex128"),
        ("K", "str of dtype <U1"),
        (None, "NoneType of dtype object"),
    ],
)
def test_what_is_no_array_of_real_numbers_is_refused(value: object, kind: str) -> None:
    with pytest.raises(InputError) as caught:
        as_numpy(value, "K")
    assert str(caught.value) == f"K is not an array of real numbers but {kind}"
