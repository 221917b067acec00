"""A share of `python -m fuzz.kills` that fits the suite, and its own eyes."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from fuzz import kills


def test_a_batch_that_is_killed_and_stopped_ends_with_the_same_result(tmp_path: Path) -> None:
    stable = ("out/pairs.jsonl", "out/matches.h5", "out/plan.json")
    bench = kills.Bench(kills.SCENARIOS["batch"], tmp_path, stable)
    result = kills.Result()
    plan = [(signal.SIGKILL, 0.9), (signal.SIGINT, 0.7)]
    bench.disturb("run", plan, result)
    assert result.faults == []


@pytest.mark.parametrize(
    ("name", "content", "whole"),
    [
        ("a.json", b'{"a": 1}', True),
        ("a.json", b'{"a"', False),
        ("a.npz", b"PK\3\4", False),
        ("a.h5", b"\x89HDF", False),
        ("a.png", b"\x89PNG", False),
        ("a.html", b"<html></html>\n", True),
        ("a.html", b"<html>", False),
        ("a.jsonl", b'{"a": 1}\n{', False),
    ],
)
def test_half_an_output_is_seen(tmp_path: Path, name: str, content: bytes, whole: bool) -> None:
    (tmp_path / name).write_bytes(content)
    assert kills.is_whole(tmp_path / name) == whole
