import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair, read_pair_list, read_pairs, write_pairs
from dgc_pose.errors import InputError

K = "500 0 320 0 510 240 0 0 1"
R = Rotation.from_euler("xyz", [10, -20, 5], degrees=True).as_matrix()
T = np.vstack([np.column_stack([R, [1.0, 2.0, -3.0]]), [0, 0, 0, 1]])


def line(*, names="a.png b.png", rotations="0 0", k1=K, k2=K, pose=T):
    return f"{names} {rotations} {k1} {k2} {' '.join(repr(float(v)) for v in np.ravel(pose))}\n"


def pair_file(tmp_path, text, name="pairs.txt"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_fields_are_read_in_superglues_order(tmp_path):
    k1 = " ".join(str(v) for v in [500, 1, 320, 0, 510, 240, 0, 0, 1])
    k2 = " ".join(str(v) for v in [700, 2, 420, 0, 710, 340, 0, 0, 1])
    path = pair_file(tmp_path, line(names="x/a.png y/b.png", k1=k1, k2=k2))
    (pair,) = read_pairs(path)
    assert (pair.name1, pair.name2) == ("x/a.png", "y/b.png")
    assert (pair.path1, pair.path2) == (tmp_path / "x/a.png", tmp_path / "y/b.png")
    assert read_pairs(path, root="images")[0].path1 == Path("images/x/a.png")
    assert np.array_equal(pair.camera1.K, [[500, 1, 320], [0, 510, 240], [0, 0, 1]])
    assert np.array_equal(pair.camera2.K, [[700, 2, 420], [0, 710, 340], [0, 0, 1]])
    assert np.allclose(pair.R, R, atol=1e-12)
    assert np.array_equal(pair.t, [1, 2, -3])
    (pair,) = read_pairs(pair_file(tmp_path, line(pose=np.round(T, 4))))
    assert np.allclose(pair.R.T @ pair.R, np.eye(3), atol=1e-14)
    assert np.degrees(Rotation.from_matrix(pair.R.T @ R).magnitude()) < 0.01


def test_written_pairs_are_read_back(tmp_path):
    rng = np.random.default_rng(3)
    cameras = [Camera(np.array([801.25, 799, 400.5, 300])), Camera(np.array([650, 640, 200, 100]))]
    rotations = [Rotation.random(random_state=i).as_matrix() for i in range(5)]
    pairs = [
        Pair(f"images/{i}.png", f"{i}.jpg", tmp_path, *cameras, R, rng.normal(size=3) * 100)
        for i, R in enumerate(rotations)
    ]
    write_pairs(tmp_path / "list.txt", pairs)
    for read, pair in zip(read_pairs(tmp_path / "list.txt"), pairs, strict=True):
        assert (read.path1, read.path2) == (pair.path1, pair.path2)
        np.testing.assert_array_equal(read.camera1.K, cameras[0].K)
        np.testing.assert_array_equal(read.camera2.K, cameras[1].K)
        np.testing.assert_allclose(read.R, pair.R, atol=1e-11)
        np.testing.assert_allclose(read.t, pair.t, rtol=1e-10)
    for name in ("two words.png", ""):
        with pytest.raises(InputError, match="cannot hold the name"):
            write_pairs(tmp_path / "out.txt", [*pairs, replace(pairs[0], name1=name)])
        assert not (tmp_path / "out.txt").exists()


@pytest.mark.parametrize(
    "heading",
    ["", "image0, image1, score\n", "image1_path,image2_path\n", "# pairs\nImage 1,Image 2\n"],
)
def test_csv_with_and_without_a_heading(tmp_path, heading):
    path = pair_file(tmp_path, heading + 'a b.jpg,c.jpg,0.5\n"x,y.png", c.jpg\n', "pairs.csv")
    assert read_pair_list(path).pairs == (("a b.jpg", "c.jpg"), ("x,y.png", "c.jpg"))
    for row in ("img1.png,img2.png", "img2,img3", "d/img1,d/img2"):
        path = pair_file(tmp_path, f"{row}\nimg1,img2\n", "pairs.csv")
        assert read_pair_list(path).pairs == (tuple(row.split(",")), ("img1", "img2"))


def test_shorter_lines_give_the_names_and_their_cameras(tmp_path):
    text = "# a comment\na.jpg b.jpg\n\nb.jpg  c/d.jpg\nb.jpg a.jpg\na.jpg b.jpg\n"
    pairs = read_pair_list(pair_file(tmp_path, text)).pairs
    assert pairs == (("a.jpg", "b.jpg"), ("b.jpg", "c/d.jpg"))
    for fields in (2, 4, 22, 38):
        pair_list = read_pair_list(pair_file(tmp_path, " ".join(line().split()[:fields])))
        assert pair_list.pairs == (("a.png", "b.png"),)
        assert set(pair_list.cameras) == ({"a.png", "b.png"} if fields > 4 else set())
        for camera in pair_list.cameras.values():
            np.testing.assert_array_equal(camera.K, [[500, 0, 320], [0, 510, 240], [0, 0, 1]])


NO_TEXT = "is not UTF-8 text; expected a list of pairs"
VIDEO = b"\0\0\0\x18ftypmp42" + bytes(900)


@pytest.mark.parametrize(
    ("read", "content", "reason"),
    [
        (read_pairs, "a.png b.png 0 0\n", ":4: a pair needs 38 fields, and this line has 4"),
        (read_pairs, line(k1="500 0 320 0 f 240 0 0 1"), ":4: could not convert .*: 'f'"),
        (read_pairs, line(k2="nan 0 320 0 510 240 0 0 1"), ":4: K2 has values that are not finite"),
        (read_pairs, line(k1="-500 0 320 0 510 240 0 0 1"), ":4: K1 "),
        (read_pairs, line(pose=T * [-1, 1, 1, 1]), ":4: .*T is not a rotation"),
        (read_pairs, line(pose=T * [1, 1, 1, 0] + np.diag([0, 0, 0, 1])), ":4: .*no translation"),
        (read_pairs, line(rotations="1 0"), ":4: .*rot1 rot2 must be 0 0, not 1 0"),
        (read_pairs, b"\n# nothing\n", "no pairs"),
        (read_pairs, b"\xff", NO_TEXT),
        (read_pairs, VIDEO, NO_TEXT),
        (read_pair_list, "a b c\n", ":4: expected two names"),
        (read_pair_list, "a a\n", ":4: a is paired with itself"),
        (read_pair_list, f"a b 0 0 {K.replace('500', 'x')} {K}\n", ":4: could not convert"),
        (read_pair_list, f"a.png c 0 0 {K.replace('500', '501')} {K}\n", ":4: K of a.png differs"),
        (read_pair_list, b"a,b\n,c\n", ":2: expected two names"),
        pytest.param(
            *(read_pair_list, b"a,b\n" + b"a" * 200_000 + b",b\n", ":2: field larger than"),
            id="a long field",
        ),
        (read_pair_list, b"\n# nothing\n", "no pairs"),
        (read_pair_list, b"\xff", NO_TEXT),
        (read_pair_list, VIDEO, NO_TEXT),
    ],
)
def test_a_bad_list_is_an_error_with_its_path_and_the_line(tmp_path, read, content, reason):
    """A text is of a line behind a good one and two empty ones; bytes are of a whole file."""
    data = content if isinstance(content, bytes) else f"{line()}\n  \n{content}".encode()
    path = tmp_path / ("pairs.csv" if b"," in data else "pairs.txt")
    path.write_bytes(data)
    with pytest.raises(InputError, match=reason) as caught:
        read(path)
    assert reason == "no pairs" or str(caught.value).startswith(str(path))
    assert reason != NO_TEXT or caught.value.path == path


@pytest.mark.parametrize("packed", [False, True])
def test_a_byte_order_mark_is_no_part_of_a_name(tmp_path, packed):
    path = tmp_path / ("pairs.txt.gz" if packed else "pairs.txt")
    data = line().encode("utf-8-sig")
    path.write_bytes(gzip.compress(data) if packed else data)
    assert read_pairs(path)[0].name1 == "a.png"
