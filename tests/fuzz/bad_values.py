"""Every command but those of the laboratory, with every option of a number or a path set to what it
must refuse."""

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import dense_scene
from fuzz.readers import make_batch, make_photographs
from photos import write_photos
from world_scene import world_scene, write_colmap

from dgc_pose.cli.guard import OutputFile, OutputFolder
from dgc_pose.cli.main import SECTIONS, main

_LONG = "9" * 5000
NUMBERS = ("nan", "inf", "-inf", "1e400", "-1e3", "x", "", "9" * 30, _LONG, "1;2", "٣x", "\udcff")
_BOTH = ("", "/dev/null", "fifo", "one.png", "K.txt", "x" * 5000)
OUTPUTS = (*_BOTH, "dir", "dir/", "text.txt", "loop", "no/x/y", "-/", "link")
FOLDERS = (*_BOTH, "loop/x", "run")
INPUTS = ("", "nowhere", "dir", "/dev/zero", "/dev/null", "fifo", "loop", "empty")
INPUTS += ("junk", "junk.npy", "junk.pth", "x" * 5000, "\udcff.png", "huge.png")
_NUMBERED = click.types.IntParamType | click.types.FloatParamType

_BATCH = ("--K", dense_scene.K_TEXT, "--workers", "1", "--refine", "none", "--runs", "1")
# A command line that would succeed, but for what a case changes.
_BASES: dict[str, Sequence[str]] = {
    "estimate": ("one.png", "two.png", "--K", dense_scene.K_TEXT, "--refine", "none"),
    "match": ("one.png", "two.png", "--refine", "none", "--out", "new.npz"),
    "batch": ("photos", "--out", "new", "--pairs", "sequential:1", *_BATCH),
    "reconstruct": ("photos", "--out", "new", "--pairs", "sequential:1", *_BATCH),
    "export-colmap": ("batch", "--database", "new.db"),
    "export": ("model", "--to", "nerfstudio", "--out", "new"),
}


def make_files(folder: Path) -> None:
    """The files that the command lines name."""
    dense_scene.write_pair_list(folder)
    (folder / "K.txt").write_text("300 0 159.5\n0 300 119.5\n0 0 1\n")
    (folder / "text.txt").write_text("a letter to somebody\n")
    (folder / "empty").write_text("")
    for name in ("junk", "junk.npy", "junk.pth"):
        (folder / name).write_bytes(bytes(range(256)) * 8)
    (folder / "huge.png").write_bytes(png_claiming(60_000, 50_000))
    write_photos(folder / "photos", 24)
    write_colmap(world_scene(count=9), folder / "model")
    for name in ("dir", "batch", "run"):
        (folder / name).mkdir()
    make_batch(folder / "batch")
    make_photographs(folder / "batch")
    for name in ("results.csv", "summary.json", "pairs.csv", "checkpoint.pt"):
        (folder / "run" / name).write_text("of another run\n")
    os.mkfifo(folder / "fifo")
    (folder / "loop").symlink_to("loop")
    (folder / "link").symlink_to("one.png")


def png_claiming(width: int, height: int) -> bytes:
    """A PNG of a few bytes that claims a size."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = b"\x89PNG\r\n\x1a\n"
    for kind, body in ((b"IHDR", header), (b"IDAT", zlib.compress(b"\0" * 99)), (b"IEND", b"")):
        data += struct.pack(">I", len(body)) + kind + body
        data += struct.pack(">I", zlib.crc32(kind + body))
    return data


def command_lines() -> list[tuple[str, ...]]:
    """All of them, in an order that does not change."""
    lines: list[tuple[str, ...]] = []
    for name in [*SECTIONS["Poses"], *SECTIONS["Many photographs"], "info"]:
        command = main.get_command(click.Context(main), name)
        assert command is not None
        base = tuple(_BASES.get(name, ()))
        for parameter in command.params:
            if name == "serve" and not isinstance(parameter.type, _NUMBERED):
                continue  # it runs until it is stopped, whatever its weights are
            if isinstance(parameter, click.Argument):
                lines += [(name, *words) for words in _arguments(base)]
            else:
                flag = max(parameter.opts, key=len)
                lines += [(name, *base, flag, value) for value in _values(parameter)]
    return list(dict.fromkeys(lines))


def _arguments(base: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """The base with each of its leading words, which are the arguments, exchanged."""
    for place, word in enumerate(base):
        if word.startswith("-"):
            return
        yield from ((*base[:place], value, *base[place + 1 :]) for value in INPUTS if value)


def _values(parameter: click.Parameter) -> Sequence[str]:
    kind = parameter.type
    if getattr(parameter, "is_flag", False):
        return ()
    if isinstance(kind, OutputFile):
        return OUTPUTS
    if isinstance(kind, OutputFolder):
        # What a run has left is in the way of a run alone.
        return [name for name in FOLDERS if name != "run" or "features.h5" not in kind.results]
    if isinstance(kind, _NUMBERED):
        return NUMBERS
    if isinstance(kind, click.Choice):
        return ("", "nosuch", _LONG)
    return INPUTS
