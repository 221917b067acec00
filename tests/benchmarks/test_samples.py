import numpy as np
import pytest

from dgc_pose.benchmarks.samples import (
    MatchSample,
    method_file_name,
    read_sample,
    sample_path,
    write_sample,
)
from dgc_pose.errors import InputError

KEY = ("net/all", 65, 3, 12)


def sample(count: int = 5) -> MatchSample:
    rng = np.random.default_rng(count)
    points = rng.random((2, count, 2)) * 1600
    return MatchSample(*points, rng.random(count) < 0.5)


@pytest.mark.parametrize("count", [0, 1, 60])
def test_a_sample_read_back_is_the_one_written(tmp_path, count) -> None:
    written = sample(count)
    write_sample(tmp_path, KEY, written)
    read = read_sample(tmp_path, KEY)
    assert len(read) == count
    assert np.allclose(read.points1, written.points1, atol=0.0051, rtol=0)
    assert np.allclose(read.points2, written.points2, atol=0.0051, rtol=0)
    assert read.inliers.dtype == bool
    assert read.inliers.tolist() == written.inliers.tolist()


def test_no_two_methods_share_a_file(tmp_path) -> None:
    deep = "/home/" + 40 * "somewhere/"
    names = ["a", "a/all", "a%2Fall", "a_all", "../a", deep + "a.pth", deep + "b.pth", 120 * "a"]
    names.append(method_file_name(deep + "a.pth"))  # made to look like another's file
    paths = {sample_path(tmp_path, (name, 65, 1, 2)) for name in names}
    assert len(paths) == len(names)
    assert {path.parent for path in paths} == {tmp_path / "matches"}


@pytest.mark.parametrize(
    "text",
    [
        "",
        '{"points1": [], "points2": []}',
        '{"points1": [[1, 2]], "points2": [], "inliers": []}',
        '{"points1": ["a"], "points2": [[1, 2]], "inliers": [true]}',
    ],
)
def test_what_is_no_sample_is_refused_with_its_path(tmp_path, text) -> None:
    path = sample_path(tmp_path, KEY)
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_sample(tmp_path, KEY)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
