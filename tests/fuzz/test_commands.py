"""What every command refuses, and what it never destroys: its inputs, and files of the user."""

import os
from pathlib import Path

import click
import dense_scene
import pytest
from command_line import assert_refused, contents, run
from fuzz.readers import make_batch
from hypothesis import given
from hypothesis import strategies as st
from textures import write_photos
from worlds import world_scene, write_colmap

from dgc_pose.cli.guard import OutputFile, OutputFolder
from dgc_pose.cli.main import SECTIONS, SUBCOMMANDS, main

_LONG = "9" * 5000
NUMBERS = ("nan", "inf", "-inf", "1e400", "-1e3", "x", "", "9" * 30, _LONG, "1;2", "٣x", "\udcff")
_BOTH = ("", "/dev/null", "fifo", "one.png", "K.txt", "x" * 5000)
OUTPUTS = (*_BOTH, "dir", "dir/", "junk", "loop", "no/x/y", "-/", "link")
INPUTS = ("", "nowhere", "dir", "/dev/zero", "fifo", "loop", "empty", "junk", "\udcff.png")
_NUMBERED = click.types.IntParamType | click.types.FloatParamType

K = ("--K", dense_scene.K_TEXT)
ESTIMATE = ("estimate", "one.png", "two.png", "--weights", "sift", "--runs", "1")
BATCH = ("--pairs", "sequential:1", *K, "--workers", "1", "--runs", "1", "--refine", "none")
# A command line that would succeed, but for what a case changes.
BASES = {
    "estimate": ("one.png", "two.png", *K, "--refine", "none"),
    "match": ("one.png", "two.png", "--refine", "none", "--out", "new.npz"),
    "batch": ("photos", "--out", "new", *BATCH),
    "reconstruct": ("photos", "--out", "new", *BATCH),
    "export-colmap": ("batch", "--database", "new.db"),
    "export": ("model", "--to", "nerfstudio", "--out", "new"),
}


def command_lines():
    """Those of every command but the laboratory's, with one option or argument that is bad."""
    lines = []
    for name in [*SECTIONS["Poses"], *SECTIONS["Many photographs"], "info"]:
        base = BASES.get(name, ())
        for parameter in main.get_command(click.Context(main), name).params:
            numbered = isinstance(parameter.type, _NUMBERED)
            if name == "serve" and not numbered:
                continue  # it runs until it is stopped, whatever its weights are
            flag = max(parameter.opts, key=len)
            if isinstance(parameter, click.Argument):
                lines += [(name, value, *base[1:]) for value in INPUTS if value and base]
            elif isinstance(parameter.type, OutputFile):
                lines += [(name, *base, flag, value) for value in OUTPUTS]
            elif isinstance(parameter.type, OutputFolder):
                lines += [(name, *base, flag, value) for value in (*_BOTH, "loop/x")]
            elif numbered:
                lines += [(name, *base, flag, value) for value in NUMBERS]
            elif isinstance(parameter.type, click.Choice):
                lines += [(name, *base, flag, value) for value in ("", "nosuch", _LONG)]
            elif not parameter.is_flag:
                lines += [(name, *base, flag, value) for value in INPUTS]
    return list(dict.fromkeys(lines))


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


@given(words=st.sampled_from(command_lines()))
def test_bad_values_are_refused_in_one_line_and_change_nothing(words, folder, files, begin_anew):
    begin_anew()
    assert_refused(run(*words))
    assert contents(folder) == files[1]


def test_every_number_option_has_a_range(folder):
    for words in command_lines():
        if words[-1] in ("9" * 30, "-inf"):
            assert_refused(run(*words))


MATCH = ("match", "one.png", "two.png")
RECONSTRUCT = ("reconstruct", "batch", "--out", ".", *K)
EXPORT = ("export-colmap", "batch", "--overwrite")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ((*ESTIMATE, *K, "--overwrite", "--json", "./link"), "would be lost"),
        ((*ESTIMATE, "--overwrite", "--K", "K.txt", "--json", "K.txt"), "would be lost"),
        ((*MATCH, "--overwrite", "--weights", "junk", "--out", "junk"), "would be lost"),
        ((*EXPORT, "--database", "views/one.png"), ""),
        ((*EXPORT, "--hloc", "batch"), ""),
        (RECONSTRUCT, "is there already"),
        ((*RECONSTRUCT, "--resume"), "sparse: holds other files"),
        ((*ESTIMATE, *K, "--json", "junk"), "junk is there already: --overwr"),
        ((*ESTIMATE, *K, "--max-pixels", "76799"), "320 x 240"),
    ],
    ids=str,
)
def test_no_output_replaces_an_input_or_what_is_the_users(folder, words, line):
    assert_refused(run(*words), line)


def test_an_output_is_replaced_with_overwrite(folder):
    Path("pose.json").write_bytes(b"of the user")
    words = (*ESTIMATE, *K, "--max-pixels", "76800", "--json", "pose.json", "--overwrite")
    assert run(*words).exit_code == 0
    assert Path("pose.json").read_bytes() != b"of the user"
    assert "DGC_POSE_MAX_PIXELS" not in os.environ
    Path("pose.json").unlink()


def test_every_output_of_every_command_is_declared():
    """The guard knows the outputs by their types alone; two commands read --matches."""
    names = {"out", "json", "plot", "matches", "json_path", "plot_path"}
    for name in SUBCOMMANDS:
        for parameter in main.get_command(click.Context(main), name).params:
            last = (parameter.name or "").rpartition("__")[2]
            is_input = last == "matches" and name in ("bench-dtu", "bench-pairs")
            if last in names and not is_input and not getattr(parameter, "is_flag", False):
                assert isinstance(parameter.type, OutputFile | OutputFolder), (name, parameter)
