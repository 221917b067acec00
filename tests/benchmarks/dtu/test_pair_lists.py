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
ANGLES = [0, 8, 17, 27]
CSV = "scene,view1,view2\n65,1,3\n65,4,2\n4,2,1\n"
IDS = [(65, 1, 3), (65, 4, 2), (4, 2, 1)]


def opened(root, layout="raw"):
    for number in (4, 65):
        WRITERS[layout](root, grey_scan(ANGLES), number=number)
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


def test_a_csv_may_have_its_columns_in_any_order(tmp_path, dataset):
    path = tmp_path / "pairs.csv"
    text = "view2, scene ,note,view1\n3,65,wide,1\n2,65,,4\n1,4,x,2\n"
    path.write_text(text, encoding="utf-8-sig")
    assert ids(read_pair_file(path, dataset)) == IDS


@pytest.mark.parametrize("layout", WRITERS)
def test_superglue_lists_of_any_layout_name_the_same_views(tmp_path, dataset, layout):
    other = opened(tmp_path / "other", layout)
    drawn = draw(find_view_pairs(other, OPTIONS), OPTIONS)
    write_pairs(tmp_path / "list.txt", [listed_pair(other, pair) for pair in drawn])
    assert ids(read_pair_file(tmp_path / "list.txt", dataset)) == ids(drawn)


@pytest.mark.parametrize(
    "name1, name2, expected",
    [
        ("scan65_train/rect_001_5_r5000.png", "x/scan65/clean_003_max.png", (65, 1, 3)),
        ("scan1/dtu_scan4/image/000000.png", "scan4/images/00000002.jpg", (4, 1, 3)),
    ],
)
def test_names_of_other_lights_and_sets_name_views_too(tmp_path, dataset, name1, name2, expected):
    (tmp_path / "list.txt").write_text(f"{name1} {name2} 0 0" + " 0" * 34 + "\n")
    assert ids(read_pair_file(tmp_path / "list.txt", dataset)) == [expected]


def test_pairs_of_scenes_not_asked_for_are_passed_over(tmp_path, dataset):
    (tmp_path / "list.txt").write_text(CSV + "128,1,2\n")
    assert ids(read_pair_file(tmp_path / "list.txt", dataset, scenes=[4])) == IDS[2:]
    with pytest.raises(InputError, match=r"list\.txt:5: scan128 is not there: found scan4, scan65"):
        read_pair_file(tmp_path / "list.txt", dataset)


HEADER = "scene,view1,view2\n"
SUPERGLUE = " 0 0" + " 0" * 34
BAD_LISTS = {
    "empty": ("", r": no pairs in this list"),
    "header alone": (HEADER, r": no pairs in this list"),
    "no column": ("scene,view1\n65,1\n", r":1: expected a column view2"),
    "short row": (HEADER + "65,1\n", r":2: expected 3 columns, found 2"),
    "word": (HEADER + "65,1,two\n", r":2: expected whole numbers .* found 65,1,two"),
    "zero": (HEADER + "65,1,0\n", r":2: scan65 has views 1 to 49, not 0"),
    "same view": (HEADER + "65,3,3\n", r":2: views 3 and 3 of scan65 have one and the same"),
    "twice": (HEADER + "65,1,2\n65,2,1\n65,1,2\n", r":4: the pair of line 2 once more"),
    "fields": ("1 2 65\n", r":1: expected a CSV with scene,view1,view2, .* found 3"),
    "other image": ("one.png two.png" + SUPERGLUE, r":1: expected the name of a DTU .* one\.png"),
    "no scan": ("rect_001_3_r5000.png x.png" + SUPERGLUE, r":1: expected the name of a DTU"),
    "two scenes": (
        "scan4/rect_001_3_r5000.png scan65/rect_002_3_r5000.png" + SUPERGLUE,
        r":1: expected two views of one scene",
    ),
}


@pytest.mark.parametrize("case", BAD_LISTS)
def test_a_bad_list_is_an_error_with_its_line(tmp_path, dataset, case):
    content, message = BAD_LISTS[case]
    path = tmp_path / "list.txt"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read_pair_file(path, dataset)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
