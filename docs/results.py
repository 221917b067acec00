"""Write the table of relative poses, in README.md and docs/results.md, from docs/results.csv.

    python docs/results.py [RUNS]

With RUNS the figures of each row come first of RUNS/run, the --out of `dgc-pose bench-pairs`, if
that is there.
"""

import csv
import json
import math
import re
import sys
from datetime import date
from pathlib import Path

import numpy as np

DOCS = Path(__file__).resolve().parent
RESULTS, PAGES = DOCS / "results.csv", (DOCS.parent / "README.md", DOCS / "results.md")
FIGURES = {
    **{name: f"{{{name}}}" for name in ("date", "pairs", "failures", "wrong")},
    "R": "{median_rotation_deg:.2f}",
    "t folded": "{median_translation_folded_deg:.2f}",
    **{f"AUC@{limit}": f"{{auc{limit}:.1f}}" for limit in (5, 10, 20)},
    "s": "{seconds_per_pair:.2f}",
}
WRONG_DEG = 10  # of R or t of a pose
TABLE = re.compile(r"(<!-- table of: results\.csv -->\n\n)(?:\|.*\n)*")


def read(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def measured(row: dict[str, str], run: Path) -> dict[str, str]:
    """The row with the figures of a run, if that is there and has its method."""
    path = run / "summary.json"
    if not path.is_file():
        return row
    methods = {m["method"]: m for m in json.loads(path.read_text(encoding="utf-8"))["methods"]}
    if row["method"] not in methods:  # of another program
        return row
    figures = {k: math.inf if v is None else v for k, v in methods[row["method"]].items()}
    pairs = [pair for pair in read(run / "results.csv") if pair["method"] == row["method"]]
    names = "rotation_error_deg", "translation_error_deg"
    errors = np.array([[float(pair[name]) for name in names] for pair in pairs])
    wrong = (errors.max(1) > WRONG_DEG) & np.isfinite(errors).all(1)
    figures |= {"date": date.fromtimestamp(path.stat().st_mtime), "wrong": wrong.sum()}
    return row | {name: text.format(**figures) for name, text in FIGURES.items()}


def table(place: re.Match[str]) -> str:
    """A marker of a page and the table below it."""
    rows = read(RESULTS)
    names = [name for name in FIGURES if name != "date"]
    lines = [[f"list, measured {max(row['date'] for row in rows)}", "method", *names]]
    lines.append(["---"] * len(lines[0]))
    for row, before in zip(rows, [{"list": ""}, *rows], strict=False):
        title = row["list"] if row["list"] != before["list"] else ""
        lines.append([title, f"`{row['method']}`", *(row[name] for name in names)])
    return place[1] + "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main(runs: str | None = None) -> None:
    if runs is not None:
        rows = [measured(row, Path(runs, row["run"])) for row in read(RESULTS)]
        with RESULTS.open("w", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, [*rows[0]], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    for page in PAGES:
        page.write_text(TABLE.sub(table, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
