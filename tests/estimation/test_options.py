import pytest

from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("runs", 0),
        ("iterations", 0),
        ("iterations", -5),
        ("threshold_px", 0.0),
        ("threshold_px", -1.0),
        ("threshold_px", float("nan")),
        ("threshold_px", float("inf")),
        ("min_probability", 1.5),
        ("seed", -1),
    ],
)
def test_a_value_out_of_range_is_refused_by_its_name(field, value):
    with pytest.raises(InputError, match=field):
        EstimationOptions(**{field: value})
