"""Write what the documentation shows of the tool's own output on the bundled pairs.

    make figures

A line `<!-- output of: dgc-pose COMMAND -->` stands above each block of such output, in README.md
and docs/*.md; a block that is out of date is replaced, as tests/test_docs.py demands. `words of:`
stands above those whose numbers are of one machine: with K not known they differ by more than the
last digits. docs/demo.png, the upper part of a plot, is drawn anew.
"""

import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PICTURE = ROOT / "docs" / "demo.png"
TOP = 0.358  # of the plot's height: the headline and the matches
WIDTH = 1200  # of the picture, pixels
PALETTE = 256  # colours of the picture: a quarter of the bytes
RELATIVE, PLACES = 0.01, 2  # between processors: a share, and units of the last place printed

_BLOCK = re.compile(
    r"(<!-- (output|words) of: (dgc-pose [^\n]+) -->\n+```\w*\n)(.*?)(\n```)", re.DOTALL
)
_TIME = re.compile(r"\d+\.\d+ s\b")
_NUMBER = re.compile(r"-?\d+(?:\.(\d+))?")


def output(command: str) -> str:
    """What a command prints, with paths as seen from the repository."""
    words = [sys.executable, "-m", "dgc_pose", *shlex.split(command)[1:]]
    text = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    lines = text.replace(f"{ROOT}/", "").strip("\n").splitlines()
    return "\n".join(line.rstrip() for line in lines)


def quoted(text: str) -> Iterator[tuple[str, str, str]]:
    """The blocks of output in a page: its marker, the command and what the page says it prints."""
    for _, marker, command, block, _ in _BLOCK.findall(text):
        yield marker, command, block


def renewed(text: str) -> str:
    """A page with each block of output that does not agree replaced by what its command prints."""

    def renew(block: re.Match[str]) -> str:
        start, marker, command, old, end = block.groups()
        new = output(command)
        # Not for times and last digits.
        return start + (old if agree(old, new, marker) else new) + end

    return _BLOCK.sub(renew, text)


def agree(left: str, right: str, marker: str = "output") -> bool:
    """Whether two outputs differ only as those of two processors do: in times and last digits; of
    `words`, in any numbers."""
    left, right = _TIME.sub("", left), _TIME.sub("", right)
    # The space in front of a number depends on its sign and its length.
    if _words(left) != _words(right) or marker == "words":
        return _words(left) == _words(right)
    for number, other in zip(_NUMBER.finditer(left), _NUMBER.finditer(right), strict=True):
        first, second = float(number[0]), float(other[0])
        place = 10.0 ** -len(number[1] or "")
        tolerance = RELATIVE * max(abs(first), abs(second)) + PLACES * place
        if abs(first - second) > tolerance * (1 + 1e-9):
            return False
    return True


def _words(text: str) -> str:
    return re.sub(r" *#", " #", _NUMBER.sub("#", text))


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        drawn = Path(folder, "demo.png")
        output(f"dgc-pose demo --plot {drawn}")
        with Image.open(drawn) as picture:
            top = picture.crop((0, 0, picture.width, round(TOP * picture.height)))
            top.thumbnail((WIDTH, WIDTH))
            # FASTOCTREE keeps the colours of lines.
            colours = top.convert("RGB").quantize(PALETTE, Image.Quantize.FASTOCTREE)
        colours.save(PICTURE, optimize=True)

    for page in PAGES:
        before = page.read_text(encoding="utf-8")
        page.write_text(renewed(before), encoding="utf-8")


if __name__ == "__main__":
    main()
