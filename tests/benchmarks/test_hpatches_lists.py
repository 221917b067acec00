from __future__ import annotations

import homography_scene as scene
import numpy as np
import pytest

from dgc_pose.benchmarks.homographies import VIEWPOINTS, load_pair, read_lists
from dgc_pose.errors import InputError


@pytest.fixture
def folder(tmp_path):
    """One of two listed sequences is on the disk."""
    scene.write_sequence(tmp_path / "v_wall")
    scene.write_lists(tmp_path / "lists", ["v_adam", "v_wall"])
    return tmp_path


def test_the_pairs_of_all_lists_by_viewpoint(folder) -> None:
    found = read_lists(folder / "lists", folder)
    assert [pair.group for pair in found.pairs] == list(VIEWPOINTS)
    assert [pair.name for pair in found.pairs] == [f"v_wall 1-{k}" for k in range(2, 7)]
    assert found.missing == tuple(f"v_adam 1-{k}" for k in range(2, 7))
    first = found.pairs[0]
    assert first.path1 == folder / "v_wall" / "1.ppm"
    assert first.path2 == folder / "v_wall" / "2.ppm"
    assert first.size1 == scene.SIZE1
    np.testing.assert_array_equal(first.H, scene.H)
    assert load_pair(first).valid.any()


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda text: text.replace("H33", "H34", 1), r"1_4.csv:1: the columns H33 are lacking"),
        (lambda text: text.replace("0.95", "nought", 1), r"1_4.csv:2: .*nought"),
        (lambda text: text.replace("0.95", "nan", 1), r"1_4.csv:2: .*finite"),
        (lambda text: text.replace(",240,320,", ",,320,", 1), r"1_4.csv:2: "),
        (lambda text: text + "v_last,1,4\n", r"1_4.csv:4: 14 fields"),
        (lambda text: "", r"1_4.csv:1: the columns obj"),
    ],
)
def test_a_bad_line_is_named(folder, change, words) -> None:
    path = folder / "lists" / "hpatches_1_4.csv"
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=words):
        read_lists(folder / "lists", folder)


def test_all_five_lists_are_needed(folder) -> None:
    (folder / "lists" / "hpatches_1_5.csv").unlink()
    with pytest.raises(InputError, match="hpatches_1_5.csv: no such list"):
        read_lists(folder / "lists", folder)


def test_a_root_without_any_image_is_refused(folder) -> None:
    with pytest.raises(InputError, match="no image of the 10 pairs"):
        read_lists(folder / "lists", folder / "lists")
