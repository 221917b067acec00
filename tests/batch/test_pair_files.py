"""Lists of pairs in their formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dgc_pose.batch.pair_files import read_pair_list
from dgc_pose.errors import InputError

K = "500 0 320 0 510 240 0 0 1"
T = "1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1"


def _read(tmp_path: Path, text: str, name: str = "pairs.txt") -> tuple[tuple[str, str], ...]:
    path = tmp_path / name
    path.write_text(text)
    return read_pair_list(path).pairs


def test_two_names_a_line(tmp_path: Path) -> None:
    text = "# a comment\na.jpg b.jpg\n\nb.jpg  c/d.jpg\nb.jpg a.jpg\na.jpg b.jpg\n"
    assert _read(tmp_path, text) == (("a.jpg", "b.jpg"), ("b.jpg", "c/d.jpg"))


@pytest.mark.parametrize("heading", ["", "name1,name2\n", "image0, image1, score\n"])
def test_csv_with_and_without_a_heading(tmp_path: Path, heading: str) -> None:
    text = heading + 'a b.jpg,c.jpg,0.5\n"x,y.png", c.jpg\n'
    assert _read(tmp_path, text, "p.csv") == (("a b.jpg", "c.jpg"), ("x,y.png", "c.jpg"))


@pytest.mark.parametrize("rest", ["", " 0 0", f" 0 0 {K} {K}", f" 0 0 {K} {K} {T}"])
def test_superglue_lines(tmp_path: Path, rest: str) -> None:
    path = tmp_path / "pairs.txt"
    path.write_text(f"a.jpg b.jpg{rest}\n")
    found = read_pair_list(path)
    assert found.pairs == (("a.jpg", "b.jpg"),)
    assert set(found.cameras) == ({"a.jpg", "b.jpg"} if len(rest) > 4 else set())
    for camera in found.cameras.values():
        np.testing.assert_array_equal(camera.K, [[500, 0, 320], [0, 510, 240], [0, 0, 1]])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a.jpg\n", ":1: expected two names"),
        ("a b\na b c\n", ":2: expected two names"),
        ("a a\n", ":1: a is paired with itself"),
        ("a b 1 0\n", "rot1 rot2"),
        (f"a b 0 0 {K.replace('500', 'x')} {K}\n", ":1: could not convert"),
        (f"a b 0 0 {K} {K}\na c 0 0 {K.replace('500', '501')} {K}\n", ":2: another K of a"),
        ("\n# nothing\n", "no pairs"),
    ],
)
def test_a_wrong_list_names_the_line(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        _read(tmp_path, text)


def test_a_table_with_a_field_without_end_names_the_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=":2: field larger than"):
        _read(tmp_path, f"a,b\n{'a' * 200_000},b\n", "pairs.csv")


def test_a_list_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "pairs.txt"
    path.write_bytes(b"\xff\xfe\x00\x80" * 10)
    with pytest.raises(InputError, match="is text"):
        read_pair_list(path)
