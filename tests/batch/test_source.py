"""The images that a batch works on, what of a folder is left out, and which images are paired."""

from dataclasses import replace

import cv2
import networkx as nx
import numpy as np
import PIL.Image
import pytest
from boxes import box_picture

from dgc_pose.batch import source as of_batch
from dgc_pose.batch.given import read_given
from dgc_pose.batch.source import (
    Source,
    given_source,
    most_similar,
    open_source,
    parse_pair_choice,
    similarities,
    survey,
)
from dgc_pose.cameras.by_image import KDetails
from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image


def _save(path, format, count=0):
    pixels = np.random.default_rng(count).integers(0, 256, (48, 64, 3), np.uint8)
    PIL.Image.fromarray(pixels).save(path, format)


@pytest.mark.parametrize(
    ("plan", "result", "kept"),
    [
        ("out/batch.db", "out/more/drawn.png", False),
        ("batch/batch.db", "other.png", True),  # beside it
        ("batch.db", "picture.png", True),
        ("out/summary.json", "out/picture.png", True),
    ],
)
def test_results_are_no_photographs(tmp_path, plan, result, *, kept):
    """Of `batch` and `reconstruct`, wherever they were put; all else is taken."""
    for count, name in enumerate(("1.png", "2.jfif", result)):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        _save(tmp_path / name, "PNG", count)
    (tmp_path / plan).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / plan).write_text("{}")
    source = open_source(tmp_path)
    assert source.names == ("1.png", "2.jfif") + (result,) * kept
    assert kept or "results, beside batch.db" in "; ".join(source.skipped)


@pytest.mark.parametrize("root", ["photos/other", None])
def test_a_folder_without_any_of_the_listed_images(tmp_path, root):
    """The argument is named; one image that is there is enough, since a bad image stops nothing."""
    (tmp_path / "photos" / "other").mkdir(parents=True)
    (tmp_path / "list.txt").write_text("a.png b.png\nb.png c.png\n")
    folder = tmp_path if root is None else tmp_path / root
    with pytest.raises(InputError) as caught:
        open_source(tmp_path / "list.txt", None if root is None else folder)
    assert str(caught.value) == (
        f"root {folder}: none of the 3 images of {tmp_path / 'list.txt'} is there (first: a.png)"
    )
    _save(tmp_path / "photos" / "c.png", "PNG")
    assert open_source(tmp_path / "list.txt", tmp_path / "photos").names == (
        "a.png",
        "b.png",
        "c.png",
    )


def test_pictures_that_cannot_be_read_are_counted_where_no_pair_is_left(tmp_path):
    for number in range(30):
        (tmp_path / f"{number:02d}.jpg").write_bytes(b"")
    with pytest.raises(InputError) as caught:
        open_source(tmp_path)
    no_pair = f"{tmp_path}: no image, and a pair needs two"
    assert str(caught.value) == f"{no_pair}; 30 cannot be read (first: 00.jpg: empty)"


def _two(folder, *sizes, orientations=(1, 1)):
    """Photographs of these sizes as stored, with EXIF orientations."""
    exif = PIL.Image.Exif()
    for name, size, exif[274] in zip(("a.jpg", "b.jpg"), sizes, orientations, strict=True):
        PIL.Image.new("L", size).save(folder / name, exif=exif)
    return Source(folder, ("a.jpg", "b.jpg"), None, {})


@pytest.mark.parametrize(
    ("size", "orientation", "upright"),
    [((64, 48), 1, (64, 48)), ((48, 64), 8, (64, 48)), ((64, 48), 6, (48, 64))],
)
def test_one_K_serves_photographs_of_one_size_as_stored_or_upright(
    tmp_path, size, orientation, upright
):
    """It is turned with the pixels of one that is stored as all others."""
    source = _two(tmp_path, (64, 48), size, orientations=(1, orientation))
    cameras, bad, _ = survey(source, read_calibration("50,52,33,23", "K", KDetails()))
    first, second = cameras["a.jpg"], cameras["b.jpg"]
    np.testing.assert_allclose(first.K, [[50, 0, 33], [0, 52, 23], [0, 0, 1]])
    assert not bad and second.size == upright and second.exact
    expected = [52, 50, 24, 33] if upright == (48, 64) else [50, 52, 33, 23]
    K = second.K
    np.testing.assert_allclose([K[0, 0], K[1, 1], *K[:2, 2]], expected)


@pytest.mark.parametrize("size", [(48, 60), (48, 64)])
def test_one_K_does_not_serve_several_sizes(tmp_path, size):
    """Nor photographs that are turned without an EXIF orientation."""
    source = _two(tmp_path, (64, 48), size)
    words = f"K, and the images have several sizes .48x{size[1]} and 64x48.: give a file"
    with pytest.raises(InputError, match=words):
        survey(source, read_calibration("50,52,33,23"))


def test_an_image_that_its_K_does_not_fit_is_told_and_the_others_stay(tmp_path):
    """A K of known size; a file that lacks a camera. If K fits no image, it is refused."""
    source = _two(tmp_path, (64, 48), (48, 60))
    file = tmp_path / "K.csv"
    file.write_text("name,fx,fy,cx,cy\na.jpg,50,52,33,23\nother.jpg,9,9,9,9\n")
    for K, details, reason in (
        ("PINHOLE,64,48,50,52,33.5,23.5", KDetails(), "K is for an image of 64 x 48 pixels"),
        ("50,52,33,23", KDetails((64, 48)), "has another aspect ratio: K cannot be scaled"),
        (str(file), KDetails(), f"{file} has no camera for b.jpg"),
    ):
        cameras, bad, _ = survey(source, read_calibration(K, "K", details))
        np.testing.assert_allclose(cameras["a.jpg"].K, [[50, 0, 33], [0, 52, 23], [0, 0, 1]])
        assert [*cameras] == ["a.jpg"] and [*bad] == ["b.jpg"] and reason in bad["b.jpg"]
    file.write_text("name,fx,fy,cx,cy\nother.jpg,9,9,9,9\n")
    with pytest.raises(InputError, match=r"K\.csv has no camera for a\.jpg$"):
        survey(source, read_calibration(str(file)))


def test_without_a_K_the_cameras_are_those_of_the_source_or_auto(tmp_path):
    source = _two(tmp_path, (64, 48), (64, 48))
    listed = Camera(np.array([[50.0, 0, 33], [0, 52, 23], [0, 0, 1]]))
    cameras, bad, _ = survey(replace(source, cameras={"a.jpg": listed}), read_calibration(None))
    assert not bad and cameras["a.jpg"].exact and not cameras["b.jpg"].exact
    by_auto = survey(source, read_calibration("auto"))[0]
    assert cameras["b.jpg"].identity == by_auto["b.jpg"].identity is not None


@pytest.mark.parametrize(
    ("K", "focals", "sources"),
    [
        ("auto", (1.2, None, 1.2), ["lines"] * 3),  # of all that one camera may have taken together
        ("auto:two", (1.2, None, 0.7), ["lines", "size", "lines"]),
        ("400,400,240,180", (1.2, None), ["given"] * 2),
    ],
)
def test_the_lines_of_photographs_tell_their_camera(tmp_path, K, focals, sources):
    """Of pictures of such focal lengths, over the longer side; one of None is blank."""
    for number, focal in enumerate(focals):
        blank = np.full((360, 480, 3), 90, np.uint8)
        pixels = blank if focal is None else box_picture(focal, size=(480, 360), seed=number)
        cv2.imwrite(str(tmp_path / f"{number}.png"), pixels)
    cameras, bad, _ = survey(open_source(tmp_path), read_calibration(K))
    assert not bad and [camera.focal_source for camera in cameras.values()] == sources
    for camera, focal in zip(cameras.values(), focals, strict=True):
        if camera.focal_source == "lines":  # which are of each image for itself
            assert camera.focal_prior.lines.any() == (focal is not None)
            error = abs(np.log(camera.focal / ((focal or 1.2) * 480)))
            assert error < min(0.1, 3 * camera.focal_std)
            if K == "auto":
                assert camera.focal == cameras["0.png"].focal and camera.focal_std < 0.13


def test_photographs_that_nobody_names_do_not_count(tmp_path):
    """Beside matches, with their names; unless their folder is stated."""
    names = ("a.png", "b.png")
    points = np.ones((1, 2))
    np.savez(tmp_path / "one.npz", points1=points, points2=points, image1=names[0], image2=names[1])
    given = replace(read_given(tmp_path), sizes=dict.fromkeys(names, (480, 360)))
    before = survey(given_source(given), read_calibration(None))
    for name in names:
        cv2.imwrite(str(tmp_path / name), box_picture(1.2, size=(480, 360)))
    after = survey(given_source(given), read_calibration(None))
    assert repr(after) == repr(before)  # arrays have no ==
    cameras, _, states = survey(given_source(given, tmp_path), read_calibration(None))
    assert [camera.focal_source for camera in cameras.values()] == ["lines"] * 2
    assert [*states] == [*names] and [*before[0]] == [*names] and not before[2]


def test_the_lines_of_some_photographs_of_a_camera_are_enough(tmp_path, monkeypatch):
    """And a damaged one has a reason elsewhere."""
    seen = []

    def lines(image: Image) -> np.ndarray:
        seen.append(image.name)
        return 3.0 * (np.arange(42) == 20)

    monkeypatch.setattr(of_batch, "log_likelihoods", lines)
    for number in range(40):
        PIL.Image.new("RGB", (64, 48), (number, 0, 0)).save(tmp_path / f"{number:02}.png")
    damaged = tmp_path / "00.png"
    damaged.write_bytes(damaged.read_bytes()[:60])
    cameras, _, _ = survey(open_source(tmp_path), read_calibration("auto"))
    assert 10 < len(seen) <= 16 and len({*seen}) == len(seen)
    assert len({camera.focal for camera in cameras.values() if camera.size == (64, 48)}) == 1
    assert len(cameras) >= 39


@pytest.mark.parametrize(
    ("text", "count", "pairs"),
    [
        ("exhaustive", 3, [(0, 1), (0, 2), (1, 2)]),
        ("sequential:1", 3, [(0, 1), (1, 2)]),
        ("sequential:2", 4, [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]),
        ("auto:7", 3, []),
    ],
)
def test_the_pairs_of_a_choice(text, count, pairs):
    assert parse_pair_choice(text).pairs(count) == pairs
    for other in ("all", "auto:0", "sequential:x"):
        with pytest.raises(InputError, match="^pairs"):
            parse_pair_choice(other)


@pytest.mark.parametrize("most", [1, 3])
def test_the_most_similar_ones_and_a_spanning_tree(most):
    """Each image has its `most` best partners; networkx' maximum spanning tree is there too."""
    rng = np.random.default_rng(5)
    scores = rng.random((12, 12))
    scores[:6, 6:] *= 0.01  # two groups, which only the tree connects
    scores = np.triu(scores, 1)
    scores += scores.T
    found = set(most_similar(scores, most))
    for i in range(12):
        best = sorted((j for j in range(12) if j != i), key=lambda j: -scores[i, j])[:most]
        assert {(min(i, j), max(i, j)) for j in best} <= found
    graph = nx.from_numpy_array(scores)
    tree = {tuple(sorted(edge)) for edge in nx.maximum_spanning_edges(graph, data=False)}
    assert tree <= found
    assert len(found) <= 12 * most + 11
    assert nx.is_connected(nx.Graph(list(found)))


def _cells(rng, count):
    cells = rng.standard_normal((count, 32))
    return cells / np.linalg.norm(cells, axis=1, keepdims=True)


def _score(one, other):
    """Cell by cell."""
    best = [max(float(a @ b) for b in other) for a in one]
    best += [max(float(a @ b) for a in one) for b in other]
    return sum(best) / len(best)


def test_scores_are_those_of_a_plain_loop():
    """Also of images of different shapes; the progress counts pairs."""
    rng = np.random.default_rng(0)
    features = [_cells(rng, count) for count in (20, 20, 12, 30)]
    told = []
    scores = similarities(features, lambda done, of: told.append((done, of)))
    assert told == [(1, 6), (3, 6), (6, 6)]
    np.testing.assert_array_equal(scores, scores.T)
    for i, j in ((0, 1), (0, 2), (3, 2)):
        assert abs(scores[i, j] - _score(features[i], features[j])) < 1e-6
