"""Command-line options made of dataclass fields, and those of K."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import click
import numpy as np
import pytest
from click.testing import CliRunner

from dgc_pose.cli.guard import guarded
from dgc_pose.cli.options import (
    CameraChoice,
    KChoice,
    dataclass_options,
    parse_deviations,
    parse_size,
)
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.images.image import Image
from dgc_pose.system.options import option


@dataclass(frozen=True)
class Inner:
    share: float = option(0.5, "Of the pairs.", min=0, max=1)
    hidden: int = 3


@dataclass(frozen=True)
class Options:
    folder: Path = option(help="Where.")
    kind: Literal["fast", "good"] = option("good", "Which.", flag="--how")
    limit_px: float | None = option(
        None, "At most.", flag="--limit", metavar="PX", above=0, section="advanced"
    )
    names: tuple[str, ...] = option((), "May be repeated.")
    size: tuple[int, int] = option((4, 3), "Of views.", parse=parse_size, text="4x3")
    quick: bool = option(False, "Be quick.")
    safe: bool = option(True, "Be safe.")
    secret: int = option(7, min=0)
    inner: Inner = field(default_factory=Inner)

    def __post_init__(self) -> None:
        if "c" in self.names:
            raise InputError(ArgumentName("names"), "has c")


def _invoke(*words: str) -> tuple[Any, Any]:
    passed: list[Any] = []

    @click.command()
    @click.option("--plain")
    @dataclass_options(Options, "options")
    def command(options: Options, plain: str | None) -> None:
        passed.append(options)

    result = CliRunner().invoke(guarded(command), words)
    return result, passed[0] if passed else None


def test_every_kind_of_field_is_read_and_has_its_default() -> None:
    words = "--folder f --how fast --limit 1.5 --names a --names b --size 7x8 --quick --no-safe"
    result, options = _invoke(*words.split(), "--share", "0.25")
    assert result.exit_code == 0, result.output
    expected = Options(Path("f"), "fast", 1.5, ("a", "b"), (7, 8), True, False, inner=Inner(0.25))
    assert options == expected
    assert _invoke("--folder", "there")[1] == Options(Path("there"))


def test_the_help_has_texts_choices_defaults_and_sections() -> None:
    text = " ".join(_invoke("--help")[0].output.split())
    for part in ("Where. [required]", "[fast|good] Which. [default: good]", "[default: 4x3]"):
        assert part in text
    assert "--secret" not in text and "--hidden" not in text
    options, _, advanced = text.partition("Advanced:")
    assert "--limit PX" in advanced and "--debug" in advanced and "--limit" not in options


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--limit", "0"], "--limit must be above 0, not 0.0"),
        (["--limit", "nan"], "--limit must be a number, not nan"),
        (["--size", "big"], "must be WxH in pixels, such as 1600x1200, not 'big'"),
        (["--names", "c"], "--names has c"),
    ],
)
def test_what_is_refused_names_the_flag(words: list[str], message: str) -> None:
    result, _ = _invoke("--folder", "f", *words)
    assert message in result.output or message in str(result.exception)


IMAGE = Image(np.zeros((240, 320, 3), np.uint8))
K = "500,510,320,240"


def test_sizes_and_deviations() -> None:
    assert parse_size(" 1600x1200 ") == parse_size("1600X1200") == (1600, 1200)
    assert parse_deviations("0.02") == (0.02, 0)
    assert parse_deviations("0.02, 3") == (0.02, 3)
    details = KChoice(K, (640, 480), (0.02, 3.0)).details
    assert (details.size, details.focal_std, details.centre_std) == ((640, 480), 0.02, 3)
    for text in ("1600", "1600x", "0x1", "-1x2", "1.5x2", ""):
        with pytest.raises(InputError, match="^must be WxH in pixels, such as 1600x1200"):
            parse_size(text)
    for text in ("", "a", "-1", "0.1,2,3", "2", "0.1,-1", "nan", "0.1,inf"):
        with pytest.raises(InputError, match="^must be F or F,C"):
            parse_deviations(text)


def test_the_cameras_of_a_pair() -> None:
    choice = CameraChoice(K, (640, 480), (0.02, 3.0), k2="PINHOLE,640,480,400,400,320,240")
    camera1, camera2 = choice.resolve(IMAGE, IMAGE)
    assert (camera1.K[0, 0], camera2.K[0, 0]) == (250, 200)
    assert camera1.focal_std == camera2.focal_std == 0.02
    assert camera1.identity != camera2.identity
    camera1, camera2 = CameraChoice("auto", k1="160,160,160,120").resolve(IMAGE, IMAGE)
    assert (camera1.focal_std, camera2.focal_source) == (0, "size")
    camera1, camera2 = CameraChoice(fov=90, k_std=(0.1, 2.0)).resolve(IMAGE, IMAGE)
    assert camera1.focal == camera2.focal == pytest.approx(160) and camera2.focal_std == 0.1
    with pytest.raises(InputError, match="^--K2: 'K' is neither"):
        CameraChoice("160,160,160,120", k2="K").resolve(IMAGE, IMAGE)
