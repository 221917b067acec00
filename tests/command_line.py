"""Commands, run in this process, and what one that refuses its input prints and leaves."""

from pathlib import Path

from click.testing import CliRunner, Result

from dgc_pose.cli.main import main


def run(*words: object) -> Result:
    """The result of `dgc-pose WORDS`."""
    return CliRunner().invoke(main, [str(word) for word in words])


def assert_refused(result: Result, *words: str) -> None:
    """Exit code 2 and one line of error, with these words, alone."""
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr


def assert_all_bad(result: Result, *reasons: str) -> None:
    """Exit code 2, a line with the reason for each image, and one that none is left."""
    *named, last = [line for line in result.stderr.splitlines() if "K is not stated" not in line]
    assert (result.exit_code, len(named)) == (2, len(reasons)), result.output
    assert last == f"error: none of the {len(reasons)} images can be used"
    for line, reason in zip(named, reasons, strict=True):
        assert line.startswith("bad image ") and reason in line


def contents(folder: Path) -> dict[Path, bytes]:
    """Everything in a folder, at any depth."""
    return {
        path: path.read_bytes() if path.is_file() else b"" for path in sorted(folder.rglob("*"))
    }
