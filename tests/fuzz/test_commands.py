"""What every command refuses, and what it never destroys: its inputs, and files of the user."""

import os
from pathlib import Path

import click
import dense_scene
import pytest
from command_line import assert_refused, contents, run
from fuzz.readers import make_batch
from textures import write_photos
from worlds import world_scene, write_colmap

from dgc_pose.cli.guard import OutputFile, OutputFolder
from dgc_pose.cli.main import SECTIONS, SUBCOMMANDS, main

NUMBERS = ("nan", "-inf", "x", "", "9" * 30, "٣x")
OUTPUTS = ("", "/dev/null", "one.png", "K.txt", "x" * 5000)
FILES = ("dir/", "junk", "loop", "no/x/y", "-/", "link")
INPUTS = ("nowhere", "dir", "fifo", "loop", "empty", "junk", "\udcff.png")
_NUMBERED = click.types.IntParamType | click.types.FloatParamType

K = ("--K", dense_scene.K_TEXT)
ESTIMATE = ("estimate", "one.png", "two.png", "--weights", "sift", "--runs", "1")
BATCH = ("--pairs", "sequential:1", *K, "--workers", "1", "--runs", "1", "--refine", "none")
EXPORT = ("export-colmap", "batch", "--overwrite")
RECONSTRUCT = ("reconstruct", "batch", "--out", ".", *K)
# A command line that would succeed, but for what a case changes.
BASES = {
    "estimate": ("one.png", "two.png", *K, "--refine", "none"),
    "batch": ("photos", "--out", "new", *BATCH),
    "reconstruct": ("photos", "--out", "new", *BATCH),
    "export-colmap": ("batch", "--database", "new.db"),
    "export": ("model", "--to", "nerfstudio", "--out", "new"),
}


def bad_values(parameter):
    if isinstance(parameter, click.Argument):
        return INPUTS
    if isinstance(parameter.type, OutputFile):
        return OUTPUTS + FILES
    if isinstance(parameter.type, OutputFolder):
        return OUTPUTS
    if isinstance(parameter.type, _NUMBERED):
        return NUMBERS
    if isinstance(parameter.type, click.Choice):
        return ("", "nosuch")
    return () if parameter.is_flag else ("", *INPUTS)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the files that the command lines name, and their contents."""
    folder = tmp_path_factory.mktemp("files")
    dense_scene.write_pair_list(folder)
    (folder / "K.txt").write_text("300 0 159.5\n0 300 119.5\n0 0 1\n")
    (folder / "empty").write_text("")
    (folder / "junk").write_bytes(bytes(range(256)) * 8)
    write_photos(folder / "photos", 24)
    write_colmap(world_scene(count=9), folder / "model")
    for name in ("dir", "sparse/1"):
        (folder / name).mkdir(parents=True)
    make_batch(folder)
    (folder / "sparse/1/letter.txt").write_text("of the user")
    os.mkfifo(folder / "fifo")
    (folder / "loop").symlink_to("loop")
    (folder / "link").symlink_to("one.png")
    return folder, contents(folder)


@pytest.fixture
def folder(files, monkeypatch):
    """The working folder, which a test leaves as it was."""
    monkeypatch.chdir(files[0])
    yield files[0]
    assert contents(files[0]) == files[1]


@pytest.mark.parametrize("name", [*SECTIONS["Poses"], *SECTIONS["Many photographs"], "info"])
def test_each_bad_value_is_refused_in_one_line_and_changes_nothing(folder, begin_anew, name):
    base = BASES.get(name, ())
    for parameter in main.get_command(click.Context(main), name).params:
        is_argument, flag = isinstance(parameter, click.Argument), max(parameter.opts, key=len)
        if name == "serve" and not isinstance(parameter.type, _NUMBERED):
            continue  # it runs until it is stopped, whatever its weights are
        for value in bad_values(parameter) if base or not is_argument else ():
            begin_anew()
            assert_refused(
                run(name, *((value, *base[1:]) if is_argument else (*base, flag, value)))
            )


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ((*ESTIMATE, *K, "--overwrite", "--json", "./link"), ": choose another"),
        (
            (*ESTIMATE, "--overwrite", "--K", "K.txt", "--json", "K.txt"),
            "this output is an input: choose another",
        ),
        ((*EXPORT, "--database", "views/one.png"), ""),
        ((*EXPORT, "--hloc", "batch"), ""),
        (RECONSTRUCT, "exists already"),
        ((*RECONSTRUCT, "--resume"), "sparse contains files that are not part of a model"),
        ((*ESTIMATE, *K, "--json", "junk"), "junk exists already: --overwr"),
    ],
    ids=str,
)
def test_no_output_replaces_an_input_or_what_is_the_users(folder, words, line):
    assert_refused(run(*words), line)


def test_an_output_is_replaced_with_overwrite(folder):
    Path("pose.json").write_bytes(b"of the user")
    assert run(*ESTIMATE, *K, "--json", "pose.json", "--overwrite").exit_code == 0
    assert Path("pose.json").read_bytes() != b"of the user"
    Path("pose.json").unlink()


def test_every_output_of_every_command_is_declared():
    """The guard knows the outputs by their types alone; two commands read --matches."""
    names = {"out", "json", "plot", "matches", "map", "json_path", "plot_path"}
    for name in SUBCOMMANDS:
        for parameter in main.get_command(click.Context(main), name).params:
            last = (parameter.name or "").rpartition("__")[2]
            is_input = last == "matches" and name in ("bench-dtu", "bench-pairs")
            if last in names and not is_input and not getattr(parameter, "is_flag", False):
                assert isinstance(parameter.type, OutputFile | OutputFolder), (name, parameter)
