"""Methods by specification, and what each takes of a map."""

import cv2
import numpy as np
import pytest

from dgc_pose.benchmarks.camera_trial import CameraTrial
from dgc_pose.benchmarks.methods import load_matchers, parse_methods
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import Image
from dgc_pose.matching import MatchingOptions

BLOTS = np.random.default_rng(0).integers(0, 255, (40, 40, 3), np.uint8)
IMAGE = Image(cv2.resize(BLOTS, (200, 200)))


def test_names_stand_for_methods() -> None:
    methods = parse_methods(["sift", "a/b.pth/all", "raft"], stored=["raft", "other"])
    assert [(method.name, method.matcher.weights, method.everywhere) for method in methods] == [
        ("sift", "sift", False),
        ("a/b.pth/all", "a/b.pth", True),
        ("raft", "raft", False),
        ("other", "other", False),
    ]
    # One that is asked for without its mask alone is not added with it.
    (method,) = parse_methods(["raft/all"], stored=["raft"])
    assert (method.name, method.matcher.weights, method.everywhere) == ("raft/all", "raft", True)


@pytest.mark.parametrize(
    ("names", "stored", "reason"),
    [
        ([], [], "no methods"),
        (["dis", "sift", "dis"], [], "'dis' is named twice"),
        (["sift/all"], [], "key points alone"),
        (["dis:magic=1"], [], "dis:magic=1: no option magic"),
        (["dis:runs=many"], [], "runs cannot be 'many'"),
        (["sift:refine=auto"], [], "refine=auto needs the features of a network"),
        (["net:K=auto:three"], [], "K cannot be 'auto:three'"),
    ],
)
def test_names_that_stand_for_none(names, stored, reason) -> None:
    with pytest.raises(InputError, match=reason):
        parse_methods(names, stored=stored)


def test_settings_are_put_in_wherever_a_field_has_their_name() -> None:
    (method,) = parse_methods(["net:refine=none:max_matches=300:runs=2"])
    assert method.matcher.matching == MatchingOptions(max_matches=300, aligned="none")
    assert method.estimation == EstimationOptions(runs=2)
    (other,) = parse_methods(["net:threshold_px=1.5:refine_pose=false"])
    assert other.estimation == EstimationOptions(threshold_px=1.5, refine=False)
    assert other.matcher.matching == MatchingOptions()
    (none,) = parse_methods(["net:threshold_px=none"], None, EstimationOptions(threshold_px=1.0))
    assert none.estimation.threshold_px is None


def test_networks_alone_are_refined_unless_asked_for() -> None:
    """A path may hold colons and equals signs."""
    names = ["net", "net:refine=none", "C:/runs=2/net.pth/all:runs=2", "dis", "sift", "raft"]
    methods = parse_methods(names, stored=["raft"])
    sources = [method.matcher.matching.aligned for method in methods]
    assert sources == ["auto", "none", "none", "none", "none", "none"]
    assert (methods[2].matcher.weights, methods[2].everywhere) == ("C:/runs=2/net.pth", True)
    assert methods[2].estimation.runs == 2


def test_a_method_has_a_trial_of_the_cameras_of_its_own() -> None:
    names = ["a:K=auto:shared", "C:/net:K=auto:two:runs=2", "sift:K_scale=0.8:K=none", "dis"]
    methods = parse_methods(names, cameras=CameraTrial(k="list"))
    assert [(method.matcher.weights, method.cameras) for method in methods] == [
        ("a", CameraTrial(k="auto:shared")),
        ("C:/net", CameraTrial(k="auto:two")),
        ("sift", CameraTrial(k_scale=0.8)),
        ("dis", CameraTrial(k="list")),
    ]
    assert methods[1].estimation.runs == 2


def test_a_network_is_read_once_for_all_methods() -> None:
    names = ["dgcm-lite0", "mine", "dgcm-lite0:max_matches=60", "dis/all"]
    methods = parse_methods(names, stored=["mine"])
    network, stored, other, dis = load_matchers(methods, device="cpu", stored={"mine": {}})
    assert other.engine is network.engine is not None and other is not network
    assert (stored.name, dis.name) == ("mine", "dis")
    with pytest.raises(InputError, match="nowhere: no such file, and no such matcher.* sift, "):
        load_matchers(parse_methods(["nowhere"]), device="cpu")
