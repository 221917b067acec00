import pytest
from dtu_layout import WRITERS, grey_scan

from dgc_pose.benchmarks.dtu.dataset import open_dataset
from dgc_pose.benchmarks.dtu.pair_lists import read_pair_file, write_pair_csv
from dgc_pose.benchmarks.dtu.view_pairs import (
    ViewPairOptions,
    draw,
    find_view_pairs,
    listed_pair,
)
from dgc_pose.cameras.pair_list import write_pairs
from dgc_pose.errors import InputError

OPTIONS = ViewPairOptions(pairs=8, min_overlap=0)
HEADER = "scene,view1,view2\n"
NUMBERS = " 0 0" + 2 * " 9 0 4 0 9 3 0 0 1" + " 1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1\n"  # K1, K2, T


def opened(root, layout="raw"):
    for number in (4, 65):
        WRITERS[layout](root, grey_scan([0, 8, 17, 27]), number=number)
    return open_dataset(root)


@pytest.fixture
def dataset(tmp_path):
    return opened(tmp_path / "dtu")


def ids(pairs):
    return [(pair.scene, pair.view1, pair.view2) for pair in pairs]


def test_our_csv_reads_back(tmp_path, dataset):
    drawn = draw(find_view_pairs(dataset, OPTIONS), OPTIONS)
    write_pair_csv(tmp_path / "pairs.csv", drawn)
    text = (tmp_path / "pairs.csv").read_text()
    assert text.startswith("scene,view1,view2,rotation_deg,overlap,baseline_mm\n4,")
    assert text.count("\n") == 9
    assert read_pair_file(tmp_path / "pairs.csv", dataset) == drawn


def test_a_csv_may_have_its_columns_in_any_order_and_other_scenes(tmp_path, dataset):
    path = tmp_path / "pairs.csv"
    text = "view2, scene ,note,view1\n3,65,wide,1\n2,65,,4\n1,4,x,2\n"
    path.write_text(text, encoding="utf-8-sig")
    assert ids(read_pair_file(path, dataset)) == [(65, 1, 3), (65, 4, 2), (4, 2, 1)]
    path.write_text(text + "2,128,,1\n")
    assert ids(read_pair_file(path, dataset, scenes=[4])) == [(4, 2, 1)]


@pytest.mark.parametrize("layout", WRITERS)
def test_superglue_lists_of_any_layout_name_the_same_views(tmp_path, dataset, layout):
    other = opened(tmp_path / "other", layout)
    drawn = draw(find_view_pairs(other, OPTIONS), OPTIONS)
    write_pairs(tmp_path / "list.txt", [listed_pair(other, pair) for pair in drawn])
    assert ids(read_pair_file(tmp_path / "list.txt", dataset)) == ids(drawn)


@pytest.mark.parametrize(
    "names, expected",
    [
        ("scan65_train/rect_001_5_r5000.png x/scan65/clean_003_max.png", (65, 1, 3)),
        ("scan1/dtu_scan4/image/000000.png scan4/images/00000002.jpg", (4, 1, 3)),
    ],
)
def test_names_of_other_lights_and_sets_name_views_too(tmp_path, dataset, names, expected):
    (tmp_path / "list.txt").write_text(names + NUMBERS)
    assert ids(read_pair_file(tmp_path / "list.txt", dataset)) == [expected]


@pytest.mark.parametrize(
    "content, message",
    [
        ("", ": no pairs in this list"),
        (HEADER, ": no pairs in this list"),
        ("scene,view1\n65,1\n", " is not a table with columns scene, view1 and view2"),
        (HEADER + "65,1\n", ":2 is not a row of whole numbers"),
        (HEADER + "65,1,two\n", ":2 is not a row of whole numbers"),
        (HEADER + "65,1,0\n", ":2: scan65 has no view 0"),
        (HEADER + "65,3,3\n", ":2: views 3 and 3 of scan65 have one and the same"),
        (HEADER + "128,1,2\n", ":2: scan128 is none of the 2 scans"),
        ("one.png two.png" + NUMBERS, ": one.png two.png: expected the names of DTU images"),
        ("scan4/rect_001_x.png scan65/rect_002_x.png" + NUMBERS, ": expected two views of one"),
    ],
)
def test_a_bad_list_is_an_error_with_its_place(tmp_path, dataset, content, message):
    path = tmp_path / "list.txt"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read_pair_file(path, dataset)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
