"""Methods by name, and what each is told of the cameras."""

import dense_scene
import numpy as np
import pytest

from dgc_pose.benchmarks.methods import CameraTrial, load_matchers, parse_methods
from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import auto_cameras
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image

IMAGE = Image(np.zeros((240, 320, 3), np.uint8))
CAMERA = Camera(dense_scene.K)


def test_names_stand_for_methods_and_networks_alone_are_refined() -> None:
    """A path may hold colons and equals signs."""
    names = ["a", "C:/runs=2/b.pth/all", "sift", "dis", "raft"]
    methods = parse_methods(names, cameras=CameraTrial(k="list"), stored=["raft", "other"])
    assert [(m.matcher.weights, m.everywhere, m.matcher.matching.aligned) for m in methods] == [
        ("a", False, "auto"),
        ("C:/runs=2/b.pth", True, "none"),
        ("sift", False, "none"),
        ("dis", False, "none"),
        ("raft", False, "none"),
        ("other", False, "none"),
    ]
    assert all(method.cameras == CameraTrial(k="list") for method in methods)
    # One that is asked for without its mask alone is not added with it.
    (method,) = parse_methods(["raft/all"], stored=["raft"])
    assert (method.name, method.matcher.weights, method.everywhere) == ("raft/all", "raft", True)


@pytest.mark.parametrize(
    ("names", "stored", "reason"),
    [
        ([], [], "no methods"),
        (["dis", "sift", "dis"], [], "'dis' is named twice"),
        (["sift/all"], [], "no dense map"),
    ],
)
def test_names_that_stand_for_none(names, stored, reason) -> None:
    with pytest.raises(InputError, match=reason):
        parse_methods(names, stored=stored)


def test_a_K_that_is_withheld_cannot_be_scaled() -> None:
    with pytest.raises(InputError, match="cannot be scaled"):
        CameraTrial(k="auto", k_scale=2.0)
    with pytest.raises(InputError, match="k must be"):
        CameraTrial(k="auto:three")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("k", "sharing"), [("auto", "files"), ("auto:shared", "shared"), ("auto:two", "two")]
)
def test_a_K_that_is_withheld_is_that_of_the_images(k, sharing) -> None:
    pair = PosedPair(IMAGE, IMAGE, CAMERA, CAMERA, dense_scene.R, dense_scene.T)
    told = CameraTrial(k=k).cameras(pair)
    for camera, expected in zip(told, auto_cameras(IMAGE, IMAGE, sharing), strict=True):
        assert np.array_equal(camera.K, expected.K)
        assert (camera.focal_std, camera.identity) == (expected.focal_std, expected.identity)
    assert (told[0].identity == told[1].identity) == (k != "auto:two")


def test_a_network_is_read_once_for_all_methods() -> None:
    names = ["dgcm-lite0", "mine", "dgcm-lite0/all", "dis/all"]
    methods = parse_methods(names, stored=["mine"])
    network, stored, other, dis = load_matchers(methods, device="cpu", stored={"mine": {}})
    assert other.engine is network.engine is not None and other is not network
    assert (stored.name, dis.name) == ("mine", "dis")
    with pytest.raises(InputError, match="nowhere is neither a file nor a matcher.* sift, "):
        load_matchers(parse_methods(["nowhere"]), device="cpu")
