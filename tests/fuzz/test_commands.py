"""What every command refuses, and what it never destroys."""

import os
from collections.abc import Iterator
from pathlib import Path

import click
import dense_scene
import pytest
from command_line import assert_refused, contents, run
from fuzz.bad_values import command_lines, make_files
from fuzz.hang import no_hang
from hypothesis import given
from hypothesis import strategies as st

from dgc_pose.cli.guard import OutputFile, OutputFolder
from dgc_pose.cli.main import SUBCOMMANDS, main

HANG_S = 120  # of a command, on a busy machine
ESTIMATE = ("estimate", "one.png", "two.png", "--refine", "none", "--runs", "1")
K = ("--K", dense_scene.K_TEXT)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Two pictures, a list and K.txt in the working folder; the network is a map."""
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pair_list(tmp_path)
    Path("K.txt").write_text("300 0 159.5\n0 300 119.5\n0 0 1\n")
    dense_scene.replace_network(monkeypatch, lambda weights: dense_scene.true_map())
    yield tmp_path


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[Path, bytes]]:
    """A folder with the files of the bad values."""
    folder = tmp_path_factory.mktemp("bad")
    make_files(folder)
    return folder, contents(folder)


@given(words=st.sampled_from(command_lines()))
def test_bad_values_are_refused_in_one_line_and_change_nothing(
    words: tuple[str, ...],
    bad: tuple[Path, dict[Path, bytes]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, before = bad
    monkeypatch.chdir(folder)
    with no_hang(HANG_S):
        result = run(*words)
    assert_refused(result)
    assert contents(folder) == before


def test_every_number_option_has_a_range() -> None:
    """Of the dataclasses' options too: they refuse what lies outside when they are made."""
    for words in command_lines():
        if words[-1] in ("9" * 30, "-inf"):
            assert_refused(run(*words))


@pytest.mark.parametrize(
    "arguments",
    [
        (*ESTIMATE, *K, "--matches", "one.png"),
        (*ESTIMATE, *K, "--json", "./link"),
        (*ESTIMATE, "--K", "K.txt", "--json", "K.txt"),
        ("match", "one.png", "two.png", "--weights", "w.pth", "--out", "w.pth"),
    ],
    ids=" ".join,
)
def test_no_output_replaces_an_input(folder: Path, arguments: tuple) -> None:
    Path("link").symlink_to("one.png")
    Path("w.pth").write_bytes(b"weights")
    before = contents(folder)
    assert_refused(run(*arguments, "--overwrite"), "would be lost")
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("option", "name"), [("--json", "pose.json"), ("--matches", "m.npz"), ("--plot", "photo.jpg")]
)
def test_an_output_that_exists_is_replaced_with_overwrite_alone(
    folder: Path, option: str, name: str
) -> None:
    Path(name).write_bytes(b"of the user")
    assert_refused(run(*ESTIMATE, *K, option, name), option, f"{name} is there already: --overwr")
    assert Path(name).read_bytes() == b"of the user"
    assert run(*ESTIMATE, *K, option, name, "--overwrite").exit_code == 0
    assert Path(name).read_bytes() != b"of the user"


def test_max_pixels_bounds_what_is_decoded(folder: Path) -> None:
    assert_refused(run(*ESTIMATE, *K, "--max-pixels", "76799"), "320 x 240", "--max-pixels")
    assert run(*ESTIMATE, *K, "--max-pixels", "76800").exit_code == 0
    assert "DGC_POSE_MAX_PIXELS" not in os.environ


def test_every_output_of_every_command_is_declared() -> None:
    """The guard knows the outputs by their types alone."""
    names = {"out", "json", "plot", "matches", "json_path", "plot_path"}
    for name in SUBCOMMANDS:
        command = main.get_command(click.Context(main), name)
        assert command is not None
        for parameter in command.params:
            last = (parameter.name or "").rpartition("__")[2]
            if last in names and not getattr(parameter, "is_flag", False):
                assert isinstance(parameter.type, OutputFile | OutputFolder), (name, parameter)
