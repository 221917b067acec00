"""Command-line options made of dataclass fields: their types, defaults, help and refusals."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import click
import pytest
from click.testing import CliRunner

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import guarded
from dgc_pose.errors import InputError
from dgc_pose.system.options import check_options, option


def _pair(text: str) -> tuple[int, int]:
    try:
        first, second = map(int, text.split("x"))
    except ValueError:
        raise InputError(f"size must be WxH, not {text}") from None
    return first, second


@dataclass(frozen=True)
class Inner:
    share: float = option(0.5, "Of the pairs.", min=0, max=1)
    hidden: int = 3

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class Options:
    folder: Path = option(help="Where.")
    kind: Literal["fast", "good"] = option("good", "Which.", flag="--how")
    level: Literal[60, 240] = option(240, "Cells.")
    limit_px: float | None = option(
        None, "At most.", flag="--limit", metavar="PX", above=0, section="advanced"
    )
    names: tuple[str, ...] = option((), "May be repeated.")
    size: tuple[int, int] = option((4, 3), "Of views.", parse=_pair, text="4x3")
    quick: bool = option(False, "Be quick.")
    safe: bool = option(True, "Be safe.")
    runs: int = option(5, "Of RANSAC.", min=1)
    secret: int = option(7, min=0)
    inner: Inner = field(default_factory=Inner)
    plain: str = "as it is"

    def __post_init__(self) -> None:
        check_options(self)


def _invoke(*words: str, **settings: Any) -> tuple[Any, Any]:
    passed: list[Any] = []

    @click.command()
    @dataclass_options(Options, "options", **settings)
    @click.option("--own", default=1)
    def command(options: Options, own: int) -> None:
        passed.append(options)

    result = CliRunner().invoke(command, words)
    return result, passed[0] if passed else None


def test_without_words_the_class_has_its_own_defaults() -> None:
    result, options = _invoke("--folder", "there")
    assert result.exit_code == 0, result.output
    assert options == Options(Path("there"))


def test_every_kind_of_field_is_read() -> None:
    words = ["--folder", "f", "--how", "fast", "--level", "60", "--limit", "1.5", "--names", "a"]
    words += ["--names", "b", "--size", "7x8", "--quick", "--no-safe", "--runs", "2"]
    words += ["--share", "0.25"]
    result, options = _invoke(*words)
    assert result.exit_code == 0, result.output
    assert options == Options(
        folder=Path("f"),
        kind="fast",
        level=60,
        limit_px=1.5,
        names=("a", "b"),
        size=(7, 8),
        quick=True,
        safe=False,
        runs=2,
        inner=Inner(0.25),
    )
    assert isinstance(options.level, int)


def test_the_help_has_texts_choices_and_defaults() -> None:
    text = " ".join(_invoke("--help")[0].output.split())
    for part in ("Where. [required]", "--how [fast|good] Which. [default: good]", "--limit PX"):
        assert part in text
    for part in ("Cells. [default: 240]", "Of views. [default: 4x3]", "pairs. [default: 0.5"):
        assert part in text
    assert "--secret" not in text and "--plain" not in text and "--hidden" not in text


def test_each_option_stands_in_its_section() -> None:
    @click.command()
    @click.option("--plain")
    @dataclass_options(Options, "options")
    def command(plain: str | None, options: Options) -> None: ...

    text = CliRunner().invoke(guarded(command), ["--help"]).output
    options, _, advanced = text.partition("Advanced:")
    assert "--plain" in options and "--folder" in options and "--limit" not in options
    assert "--limit PX" in advanced and "--debug" in advanced


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--runs", "0"], "runs must be at least 1, not 0"),
        (["--limit", "0"], "limit_px must be above 0 and finite, not 0"),
        (["--limit", "nan"], "limit_px must be above 0 and finite, not nan"),
        (["--share", "1.5"], r"share must lie in \[0, 1\], not 1.5"),
        (["--size", "big"], "size must be WxH, not big"),
    ],
)
def test_what_the_class_refuses_is_an_input_error(words: list[str], message: str) -> None:
    result, _ = _invoke("--folder", "f", *words)
    assert isinstance(result.exception, InputError)
    with pytest.raises(InputError, match=message):
        raise result.exception
