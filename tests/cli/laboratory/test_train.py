"""`dgc-pose train`: a run from a folder of photographs, its progress line, and its refusals."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from photos import write_photos

from dgc_pose.cli.main import main
from dgc_pose.network.weights import load_network

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    write_photos(folder, 40)
    return folder


def test_a_run_ends_with_weights_and_is_not_overwritten(photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ["train", "--photos", str(photos), "--out", str(out), "--minutes", "0.03"]
    words += ["--batch", "1", "--scene-share", "0", "--threads", "1"]
    words += ["--validation-pairs", "1"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.stderr
    assert load_network(out / "dgcm-lite0.safetensors").config.name == "dgcm-lite0"
    assert all(word in done.stderr for word in ("pairs/s", "loss", "validation"))
    refused = CliRunner().invoke(main, words)
    assert refused.exit_code == 2 and "--resume" in refused.stderr


def test_an_ablation_gives_its_name_to_the_weights(photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ["train", "--photos", str(photos), "--out", str(out), "--minutes", "0.1"]
    words += ["--batch", "1", "--scene-share", "0", "--validation-pairs", "1", "--split", "0,100,0"]
    words += ["--ablation", "no-dilation", "--ablation", "no-l2"]
    words += ["--warps", "paper"]
    stopped = CliRunner().invoke(main, [*words, "--stop-after", "0.0001"])
    assert stopped.exit_code == 0, stopped.stderr
    assert "of 0.1 minutes" in stopped.output and not list(out.glob("*.safetensors"))
    done = CliRunner().invoke(main, [*words, "--resume"])
    assert done.exit_code == 0, done.stderr
    config = load_network(out / "dgcm-lite0+no-dilation+no-l2.safetensors").config
    assert config.decoders[2].dilations == (1, 1, 1) and not config.normalise_features


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--ablation", "no-l3"], "no ablation 'no-l3'; there are no-l2, flow"),
        (["--warps", "narrow"], "paper-affine"),
        (["--real-share", "0.2"], "needs --rgbd"),
        (["--rgbd", "nowhere"], "nowhere"),
        (["--validation-pairs", "1", "--preset", "dgc", "--encoder", "x"], "x cannot be read"),
        (["--init", "dgcm-lite0", "--init-part", "encoder", "--encoder", "x"], "both set"),
        (["--preset", "dgc", "--encoder", "x", "--split", "100,0,0"], "it is frozen"),
        (["--batch", "0"], "batch must lie in [1, 65536]"),
        (["--steps", "3"], "in minutes or in steps, and one of them only"),
        (["--split", "50,50"], "three percentages"),
        (["--split", "90,90,10"], "sum to 1"),
        (["--scene-share", "2"], "--scene-share"),
    ],
)
def test_wrong_words_are_refused_in_one_line(
    photos: Path, tmp_path: Path, words: list[str], named: str
) -> None:
    out = tmp_path / "run"
    base = ["train", "--photos", str(photos), "--out", str(out), "--minutes", "1"]
    refused = CliRunner().invoke(main, [*base, *words])
    assert refused.exit_code == 2
    assert named in refused.stderr and refused.stderr.count("\n") == 1
    assert not out.exists()
