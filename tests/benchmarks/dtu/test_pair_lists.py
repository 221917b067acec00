import pytest
from dtu_layout import grey_scan, write_raw

from dgc_pose.benchmarks.dtu.dataset import open_dataset
from dgc_pose.benchmarks.dtu.pair_lists import choose_pairs, read_view_pairs
from dgc_pose.benchmarks.dtu.view_pairs import (
    ViewPairOptions,
    draw,
    find_view_pairs,
    listed_pair,
)
from dgc_pose.cameras.pair_list import write_pairs
from dgc_pose.errors import InputError

OPTIONS = ViewPairOptions(pairs=8, min_overlap=0)
NUMBERS = " 0 0" + 2 * " 9 0 4 0 9 3 0 0 1" + " 1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1\n"  # K1, K2, T


def opened(root):
    for number in (4, 65):
        write_raw(root, grey_scan([0, 8, 17, 27]), number=number)
    return open_dataset(root)


@pytest.fixture
def dataset(tmp_path):
    return opened(tmp_path / "dtu")


def ids(pairs):
    return [(pair.scene, pair.view1, pair.view2) for pair in pairs]


def test_a_written_list_names_the_same_views(tmp_path, dataset):
    other = opened(tmp_path / "other")
    drawn = draw(find_view_pairs(other, OPTIONS), OPTIONS)
    write_pairs(tmp_path / "list.txt", [listed_pair(other, pair) for pair in drawn])
    assert ids(read_view_pairs(tmp_path / "list.txt", dataset)) == ids(drawn)
    chosen = choose_pairs(dataset, str(tmp_path / "list.txt"), seed=0, scenes=[65])
    assert ids(chosen) == [key for key in ids(drawn) if key[0] == 65]


@pytest.mark.parametrize(
    "names, expected",
    [
        ("scan65_train/rect_001_5_r5000.png x/scan65/clean_003_max.png", (65, 1, 3)),
        ("scan1/scan4/rect_001_0_r5000.png scan4/rect_003_0_r5000.jpg", (4, 1, 3)),
    ],
)
def test_names_of_other_lights_and_sets_name_views_too(tmp_path, dataset, names, expected):
    (tmp_path / "list.txt").write_text(names + NUMBERS)
    assert ids(read_view_pairs(tmp_path / "list.txt", dataset)) == [expected]


@pytest.mark.parametrize(
    "names, message",
    [
        ("one.png two.png", ": one.png two.png: expected the names of DTU images"),
        ("scan4/rect_001_x.png scan65/rect_002_x.png", ": expected two views of one"),
        ("scan65/rect_001_x.png scan65/rect_009_x.png", ": scan65 has no view 9"),
        ("scan65/rect_003_x.png scan65/rect_003_x.png", ": views 3 and 3 of scan65 have one"),
        ("scan128/rect_001_x.png scan128/rect_002_x.png", ": scan128 is none of the 2 scans"),
    ],
)
def test_a_bad_list_is_an_error_with_its_place(tmp_path, dataset, names, message):
    path = tmp_path / "list.txt"
    path.write_text(names + NUMBERS)
    with pytest.raises(InputError, match=message) as caught:
        read_view_pairs(path, dataset)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
