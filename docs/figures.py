"""Update the output of dgc-pose that the documentation shows, on the bundled pairs.

    make figures

In README.md and docs/*.md, a line `<!-- output of: dgc-pose COMMAND -->` precedes each block of
output. This script replaces the blocks whose words are out of date (tests/test_docs.py checks them)
and draws docs/demo.png, the upper part of a plot.
"""

import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TOP = 0.345  # share of the plot's height with the headline and the matches
WIDTH = 1200  # of the picture, pixels
PALETTE = 256  # colours of the picture, which makes it four times smaller
BLOCK = re.compile(r"(<!-- output of: (dgc-pose [^\n]+) -->\n+```\w*\n)(.*?)(?=\n```)", re.DOTALL)


def output(command: str) -> str:
    """The output of a command, with paths relative to the repository."""
    words = [sys.executable, "-m", "dgc_pose", *shlex.split(command)[1:]]
    text = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    lines = text.replace(f"{ROOT}/", "").strip("\n").splitlines()
    return "\n".join(line.rstrip() for line in lines)


def words(text: str) -> str:
    """A text without its numbers and the spaces before them: last digits differ between processors,
    and spaces depend on the signs."""
    return re.sub(r" *-?\d+(?:\.\d+)?", " #", text)


def renewed(block: re.Match[str]) -> str:
    start, command, old = block.groups()
    new = output(command)
    return start + (old if words(old) == words(new) else new)


def save_picture(picture: Image.Image, name: str) -> None:
    """Write a picture of docs/ with few colours."""
    # FASTOCTREE keeps the colours of lines.
    colours = picture.convert("RGB").quantize(PALETTE, Image.Quantize.FASTOCTREE)
    colours.save(ROOT / "docs" / name, optimize=True)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        drawn = Path(folder, "demo.png")
        output(f"dgc-pose demo --plot {drawn}")
        with Image.open(drawn) as picture:
            top = picture.crop((0, 0, picture.width, round(TOP * picture.height)))
            top.thumbnail((WIDTH, WIDTH))
            save_picture(top, "demo.png")
    for page in PAGES:
        page.write_text(BLOCK.sub(renewed, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
