"""`dgc-pose train`: a run from a folder of photographs, its progress line, and its refusals."""

import pytest
from command_line import assert_refused, run
from rendered import rendered, write_rgbd
from textures import write_photos

from dgc_pose.network.weights import load_network

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos")
    write_photos(folder, 40)
    return folder


def test_a_run_ends_with_weights_and_is_not_overwritten(photos, tmp_path, monkeypatch):
    monkeypatch.setattr("dgc_pose.training.run._VALIDATION", 1)
    out = tmp_path / "run"
    for seed, scene in ((3, "hall"), (4, "yard")):
        write_rgbd(tmp_path / "posed" / scene, rendered(seed, (96, 72)))
    data = ("--posed", tmp_path / "posed", "--held", "yard", "--out", out)
    words = (*data, "--seconds", 1, "--batch", 1)
    done = run("train", "--photos", photos, *words)
    assert done.exit_code == 0, done.stderr
    assert load_network(out / "dgcm-lite0.safetensors").config.name == "dgcm-lite0"
    card = (out / "dgcm-lite0.md").read_text()
    assert "2 of 1 scenes (hall), 2 pairs train" in card and "| shares | 20,8,20,52 |" in card
    assert all(word in done.stderr for word in ("pairs_per_second", "loss", "validation"))
    # Refused before any data are read.
    words = ("train", "--photos", tmp_path / "nowhere", *words)
    assert_refused(run(*words), "--resume")
    assert_refused(run(*words, "--resume", "--seed", 5), "--seed is 5, and 0 in the run of ")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--preset", "vgg"], "no preset 'vgg'; choose one of dgc, dgcm, dgcm-lite0"),
        (["--shares", "0,100,0,0"], "no kind of pairs with a share has data"),
        (["--preset", "dgc"], "--encoder or init is needed"),
        (["--seconds", "3"], "either in seconds or in steps"),
    ],
)
def test_wrong_words_are_refused_in_one_line(photos, tmp_path, words, named):
    out = tmp_path / "run"
    assert_refused(run("train", "--photos", photos, "--out", out, "--steps", 1, *words), named)
    assert not out.exists() or "no data" in named
