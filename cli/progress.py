"""The progress of the commands that work through many pairs."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from tqdm import tqdm

from dgc_pose.cli.process import say

INTERVAL_S = 60.0  # between the lines of a log file


@contextmanager
def progress_bars() -> Iterator[Callable[[str, int, int], None]]:
    """Progress of each stage, such as "images": a bar on a terminal, elsewhere a line a minute."""
    bars: dict[str, tqdm] = {}
    lines: dict[str, tuple[float, int, float]] = {}  # the stage's start, first number, last line

    def progress(stage: str, done: int, of: int) -> None:
        if stage not in bars:
            bar = tqdm(total=of, initial=done, unit=stage.removesuffix("s"), disable=None)
            bars[stage] = stack.enter_context(bar)
        bars[stage].update(done - bars[stage].n)
        now = time.monotonic()
        start, first, last = lines.setdefault(stage, (now, done, now))
        if bars[stage].disable and (now - last >= INTERVAL_S or (done == of and last > start)):
            minutes = (now - start) / max(1, done - first) * (of - done) / 60
            say(f"{stage} {done} of {of}, {100 * done / of:.0f} %, {minutes:.0f} min left")
            lines[stage] = start, first, now

    with ExitStack() as stack:
        yield progress
