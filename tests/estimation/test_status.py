from pathlib import Path
from typing import get_args

from dgc_pose.estimation.status import STATUSES, Status

GLOSSARY = Path(__file__).resolve().parents[2] / "docs" / "glossary.md"


def test_every_status_has_its_facts_and_a_line_in_the_glossary() -> None:
    assert list(STATUSES) == list(get_args(Status))
    lines = GLOSSARY.read_text(encoding="utf-8").splitlines()
    assert [name for line in lines for name in STATUSES if line.startswith(f"| `{name}` |")] == [
        *STATUSES
    ]
