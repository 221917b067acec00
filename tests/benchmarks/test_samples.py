from pathlib import Path

import numpy as np
import pytest

from dgc_pose.benchmarks.samples import MatchSample, read_sample, sample_text
from dgc_pose.errors import InputError

TABLE = Path("matches.csv")


@pytest.mark.parametrize("count", [0, 1, 60])
def test_a_sample_read_back_is_the_one_written(count) -> None:
    rng = np.random.default_rng(count)
    written = MatchSample(*rng.random((2, count, 2)) * 1600, rng.random(count) < 0.5)
    read = read_sample(sample_text(written), TABLE)
    assert len(read) == count
    assert np.allclose(read.points1, written.points1, atol=0.0051, rtol=0)
    assert np.allclose(read.points2, written.points2, atol=0.0051, rtol=0)
    assert read.inliers.dtype == bool
    assert read.inliers.tolist() == written.inliers.tolist()


@pytest.mark.parametrize("text", ["", "{}", "[[1,2,3,4]]", '[["a",2,3,4,1]]'])
def test_what_is_no_sample_is_refused_with_the_path(text) -> None:
    with pytest.raises(InputError, match=r"matches\.csv is not a table") as caught:
        read_sample(text, TABLE)
    assert "\n" not in str(caught.value)
