"""What is no array of real numbers is told by its type and that of its values."""

from typing import Any

import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.files.arrays import as_numpy


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (np.eye(3) * 1j, "ndarray of dtype complex128"),
        (np.array([[1, None]]), "ndarray of dtype object"),
        ([[1j]], "list of dtype complex128"),
        ("K", "str of dtype <U1"),
        (None, "NoneType of dtype object"),
    ],
)
def test_other_values_are_refused(value: Any, kind: str) -> None:
    with pytest.raises(InputError) as caught:
        as_numpy(value, "K")
    assert str(caught.value) == f"K is not an array of real numbers but {kind}"
