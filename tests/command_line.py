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


def contents(folder: Path) -> dict[Path, bytes]:
    """Everything in a folder, at any depth."""
    return {
        path: path.read_bytes() if path.is_file() else b"" for path in sorted(folder.rglob("*"))
    }
