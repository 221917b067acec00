"""ALIKED and LightGlue against the released networks, and against a plain computation."""

import multiprocessing
import re
import shutil
import sys
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
from scipy.special import erf, log_expit, log_softmax, softmax

from dgc_pose import load_matcher
from dgc_pose.cameras.pair_list import bundled_photographs
from dgc_pose.errors import InputError, WeightsError
from dgc_pose.images.image import Image, load_image, masked
from dgc_pose.matching.key_points import KeyPoints
from dgc_pose.matching.lightglue import NAME, LightGlueMatcher

PACKAGE = "dgc_pose_lightglue"
PHOTOGRAPHS = [load_image(path) for path in bundled_photographs()]
SMALL = [Image(cv2.resize(image.pixels, (160, 120))) for image in PHOTOGRAPHS]


@pytest.fixture(scope="module")
def matcher(lightglue: None) -> LightGlueMatcher:
    matcher = load_matcher(NAME)
    assert isinstance(matcher, LightGlueMatcher)
    return matcher


@pytest.fixture(scope="module")
def found(matcher: LightGlueMatcher) -> list[KeyPoints]:
    return [matcher._detect(photograph) for photograph in PHOTOGRAPHS]


def test_key_points_and_matches_are_those_of_the_released_networks(
    matcher: LightGlueMatcher,
    found: list[KeyPoints],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By `wheel_lightglue.py`. The weights here have half the digits."""
    wheel = np.load(Path(__file__).parent / "wheel_lightglue.npz")
    rows = []
    for key_points, expected in zip(found, (wheel["points1"], wheel["points2"]), strict=True):
        off = np.linalg.norm(key_points.points[:, None] - expected, axis=-1)
        assert key_points.size == (1024, 768) and len(key_points.points) == 2048
        assert (off.min(0) < 0.5).mean() > 0.99 and (off.min(1) < 0.5).mean() > 0.99
        rows.append(off.argmin(1))
    matched = rows1, rows2, confidence = matcher._matched(*found)
    ours = set(zip(rows[0][rows1], rows[1][rows2], strict=True))
    theirs = {(i, j) for i, j in wheel["matches"]}
    assert len(ours & theirs) > 0.95 * max(len(ours), len(theirs)) > 500
    their_score = dict(zip(map(tuple, wheel["matches"]), wheel["scores"], strict=True))
    pairs = zip(rows[0][rows1], rows[1][rows2], confidence, strict=True)
    differences = [abs(score - their_score[i, j]) for i, j, score in pairs if (i, j) in theirs]
    assert np.median(differences) < 0.01
    monkeypatch.setattr(matcher, "_detect", lambda image: found[PHOTOGRAPHS.index(image)])
    monkeypatch.setattr(matcher, "_matched", lambda *found: matched)
    matches = matcher.match(*PHOTOGRAPHS).matches
    assert matches.key_points and matches.error_px == 1280 / 1024
    expected = (found[0].points[rows1] + 0.5) * 1.25 - 0.5
    assert {*map(tuple, matches.points1)} <= {*map(tuple, expected)} and len(matches) > 500


def plain_matches(
    weights: Mapping[str, np.ndarray], found: list[KeyPoints]
) -> Iterator[dict[tuple[int, int], float]]:
    """The scores of the matches after each layer, of all key points, in double precision."""
    w = {name: value.astype(np.float64) for name, value in weights.items()}

    def affine(name: str, x: np.ndarray) -> np.ndarray:
        return x @ w[f"{name}.weight"] + w[f"{name}.bias"]

    def heads(x: np.ndarray) -> np.ndarray:
        return x.reshape(len(x), 4, 64).transpose(1, 0, 2)

    def attention(query: np.ndarray, key: np.ndarray, value: np.ndarray) -> np.ndarray:
        shares = softmax(heads(query) @ heads(key).transpose(0, 2, 1) / 8, -1)
        return (shares @ heads(value)).transpose(1, 0, 2).reshape(len(query), 256)

    def updated(name: str, x: np.ndarray, attended: np.ndarray) -> np.ndarray:
        wide = affine(f"{name}.widen", np.hstack([x, affine(f"{name}.message", attended)]))
        wide -= wide.mean(1, keepdims=True)
        wide /= np.sqrt((wide**2).mean(1, keepdims=True) + 1e-5)
        wide = wide * w[f"{name}.norm.weight"] + w[f"{name}.norm.bias"]
        return x + affine(f"{name}.narrow", wide * (1 + erf(wide / np.sqrt(2))) / 2)

    def turned(x: np.ndarray, angles: np.ndarray) -> np.ndarray:
        parts = x.reshape(len(x), 4, 2, 32)
        z = (parts[:, :, 0] + 1j * parts[:, :, 1]) * np.exp(1j * angles)[:, None]
        return np.stack([z.real, z.imag], 2).reshape(len(x), 256)

    x = []
    angles = []
    for one in found:
        size = np.array(one.size)
        x.append(affine("input", one.descriptors))
        angles.append((2 * one.points - size) / size.max() @ w["angles"])
    for layer in range(9):
        name = f"layers.{layer}.self_attn"
        for k in range(2):
            query, key = (turned(affine(f"{name}.{p}", x[k]), angles[k]) for p in ("query", "key"))
            attended = attention(query, key, affine(f"{name}.value", x[k]))
            x[k] = updated(f"{name}.update", x[k], attended)
        name = f"layers.{layer}.cross_attn"
        queries = [affine(f"{name}.query", one) for one in x]
        values = [affine(f"{name}.value", one) for one in x]
        x = [
            updated(f"{name}.update", x[k], attention(queries[k], queries[1 - k], values[1 - k]))
            for k in range(2)
        ]
        name = f"decisions.{layer}"
        projected = [affine(f"{name}.project", one) / 4 for one in x]
        similarity = projected[0] @ projected[1].T
        z1, z2 = (log_expit(affine(f"{name}.matchable", one)) for one in x)
        scores = np.exp(log_softmax(similarity, 0) + log_softmax(similarity, 1) + z1 + z2.T)
        best = (scores == scores.max(0)) & (scores == scores.max(1, keepdims=True)) & (scores > 0.1)
        yield {(i, j): scores[i, j] for i, j in zip(*np.nonzero(best), strict=True)}


def test_matches_are_those_of_a_plain_computation_with_pruning_or_without(
    matcher: LightGlueMatcher, found: list[KeyPoints], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After one of the layers, by a share that rounding may change; after the first or the last
    if any share or none is enough."""
    few = [
        one._replace(points=one.points[:600], descriptors=one.descriptors[:600]) for one in found
    ]
    pruned, pruned_rows2, _ = matcher._matched(*few)
    monkeypatch.setattr("dgc_pose.matching.lightglue._MATCHABLE", 0.0)
    by_layer = list(plain_matches(matcher._weights, few))

    def matches_after_one_of(layers: Collection[int]) -> set[tuple[int, int]]:
        rows1, rows2, confidence = matcher._matched(*few)
        ours = dict(zip(zip(rows1, rows2, strict=True), confidence, strict=True))
        shares = []
        worst = []
        for plain in by_layer:
            common = plain.keys() & ours.keys()
            shares.append(len(common) / max(len(plain), len(ours)))
            worst.append(max((abs(plain[pair] - ours[pair]) for pair in common), default=1.0))
        layer = int(np.argmin(worst))
        assert layer in layers and shares[layer] > 0.98 and worst[layer] < 1e-3
        return set(ours)

    ours = matches_after_one_of(range(9))
    kept = ours.intersection(zip(pruned, pruned_rows2, strict=True))
    assert len(ours) > 100 and len(kept) > 0.97 * max(len(ours), len(pruned))
    for stop, layer in ((-1.0, 0), (2.0, 8)):
        monkeypatch.setattr("dgc_pose.matching.lightglue._STOP", stop)
        matches_after_one_of([layer])


def test_threads_and_forked_processes_find_the_same(matcher: LightGlueMatcher) -> None:
    alone = [matcher._detect(one).descriptors for one in SMALL]
    with ThreadPoolExecutor(3) as pool:
        threaded = [one.descriptors for one in pool.map(matcher._detect, SMALL * 2)]
    assert all(np.array_equal(one, alone[k % 2]) for k, one in enumerate(threaded))
    expected = len(matcher.match(*SMALL).matches)
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    others = [Image(one.pixels.copy()) for one in SMALL]  # not in the cache
    child = context.Process(target=lambda: queue.put(len(matcher.match(*others).matches)))
    child.start()
    child.join(120)
    assert child.exitcode == 0 and queue.get() == expected > 50


def test_matches_lie_on_no_masked_pixel(matcher: LightGlueMatcher) -> None:
    mask = np.ones((120, 160), bool)
    mask[:, ::2] = False
    both = [masked(one, mask) for one in SMALL]
    matches = matcher.match(*both).matches
    for points in (matches.points1, matches.points2):
        assert (np.floor(points[:, 0] + 0.5) % 2 == 1).all() and len(points) > 10


def test_an_image_turned_by_its_exif_data_is_as_the_upright_one(
    matcher: LightGlueMatcher, tmp_path: Path
) -> None:
    exif = PIL.Image.Exif()
    exif[0x0112] = 6  # the upper row as stored is the right column
    stored = PIL.Image.fromarray(np.rot90(SMALL[0].pixels).copy())
    stored.save(tmp_path / "turned.png", exif=exif)
    matches = matcher.match(SMALL[0], SMALL[1]).matches
    turned = matcher.match(load_image(tmp_path / "turned.png"), SMALL[1]).matches
    np.testing.assert_array_equal(turned.points1, matches.points1)
    np.testing.assert_array_equal(turned.points2, matches.points2)


def test_small_images_match_and_empty_ones_do_not(matcher: LightGlueMatcher) -> None:
    """Images of fewer pixels than there are key points, and of any size."""
    part = Image(np.ascontiguousarray(SMALL[0].pixels[100:140, 100:140]))
    matches = matcher.match(part, part).matches
    assert len(matcher._detect(part).points) < 400
    assert len(matches) > 5 and np.array_equal(matches.points1, matches.points2)
    for size in ((1, 1), (20, 33), (40, 300), (64, 64)):
        grey = Image(np.full((*size, 3), 128, np.uint8))
        for image in (grey, SMALL[0]):
            assert len(matcher.match(image, grey).matches) == 0


@pytest.fixture
def copy(lightglue: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a copy of the distribution, which is imported in place of it."""
    package = import_module(PACKAGE)
    folder = tmp_path / PACKAGE
    shutil.copytree(Path(str(package.__file__)).parent, folder)
    monkeypatch.delitem(sys.modules, PACKAGE)
    monkeypatch.syspath_prepend(tmp_path)
    return folder


@pytest.mark.parametrize(
    "name", ["aliked.onnx", "layer.onnx", "weights.json", "weights.safetensors"]
)
def test_a_damaged_file_is_named(copy: Path, name: str) -> None:
    data = (copy / name).read_bytes()
    for damaged in (b"", data[: len(data) // 2], b"\xff" * len(data)):
        (copy / name).write_bytes(damaged)
        with pytest.raises(WeightsError, match=name):
            load_matcher(NAME)
    (copy / name).unlink()
    with pytest.raises(WeightsError, match=name):
        load_matcher(NAME)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("weights.json", '"angles"', '"angels"', "weights.safetensors does .* it lacks angels"),
        ("weights.json", ".*", "[1]", "weights.json cannot be read as a table"),
        ("__init__.py", ".*", "FORMAT = 2", f"{PACKAGE} has format 2; {NAME} needs format 1"),
    ],
)
def test_a_distribution_that_does_not_fit_is_named(
    copy: Path, name: str, old: str, new: str, words: str
) -> None:
    text = (copy / name).read_text("utf-8")
    changed = re.sub(old, new, text, count=1, flags=re.DOTALL)
    (copy / name).write_text(changed, "utf-8")
    with pytest.raises(WeightsError, match=words):
        load_matcher(NAME)


def test_a_missing_distribution_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, PACKAGE, None)
    with pytest.raises(InputError) as caught:
        load_matcher(NAME)
    told = f"{NAME} needs {PACKAGE}, which is not installed: pip install ./lightglue"
    assert str(caught.value) == told
