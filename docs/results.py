"""Write the tables of relative poses, in README.md and docs/results.md, from docs/results.csv; draw
docs/speed.png from docs/speed.csv.

    python docs/results.py [RUNS]

With RUNS the figures of each row come first of RUNS/run, the --out of `dgc-pose bench-pairs`.
"""

import csv
import json
import math
import re
import sys
from datetime import date
from pathlib import Path

from dgc_pose.viz.figure import new_figure, save_figure

DOCS = Path(__file__).resolve().parent
SPEED, PICTURE = DOCS / "speed.csv", DOCS / "speed.png"
RESULTS, PAGES = DOCS / "results.csv", (DOCS.parent / "README.md", DOCS / "results.md")
FIGURES = {
    **{name: f"{{{name}}}" for name in ("date", "pairs", "failures", "wrong")},
    "R": "{median_rotation_deg:.2f}",
    "t": "{median_translation_deg:.2f}",
    "t folded": "{median_translation_folded_deg:.2f}",
    **{f"AUC@{limit}": f"{{auc{limit}:.1f}}" for limit in (5, 10, 20)},
}
WRONG_DEG = 10  # of R or t of a pose
TABLE = re.compile(r"(<!-- table of: results\.csv(, in short)? -->\n\n)(?:\|.*\n)*")


def read(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def measured(row: dict[str, str], folder: Path) -> dict[str, str]:
    """The row with what a run found."""
    path, errors = folder / "summary.json", ("rotation_error_deg", "translation_error_deg")
    methods = {m["method"]: m for m in json.loads(path.read_text(encoding="utf-8"))["methods"]}
    found = {k: math.inf if v is None else v for k, v in methods[row["method"]].items()}
    pairs = [pair for pair in read(folder / "results.csv") if pair["method"] == row["method"]]
    wrong = sum(WRONG_DEG < max(float(pair[e]) for e in errors) < math.inf for pair in pairs)
    found |= {"date": date.fromtimestamp(path.stat().st_mtime), "wrong": wrong}
    return row | {name: text.format(**found) for name, text in FIGURES.items()}


def table(place: re.Match[str]) -> str:
    """A marker of a page and the table below it; in short: the rows for README.md, without t."""
    rows = [row for row in read(RESULTS) if row["readme"] or not place[2]]
    names = [name for name in FIGURES if name != "date" and not (place[2] and name == "t")]
    lines = [[f"list, measured {max(row['date'] for row in rows)}", "method", *names]]
    lines.append(["---"] * len(lines[0]))
    for row, before in zip(rows, [{"list": ""}, *rows], strict=False):
        title = row["list"] if row["list"] != before["list"] else ""
        lines.append([title, f"`{row['method']}`", *(row[name] for name in names)])
    return place[1] + "".join(f"| {' | '.join(line)} |\n" for line in lines)


def draw_speed() -> None:
    """A panel a list, in it a point a method: AUC@10 against the seconds of a pair."""
    rows = read(SPEED)
    lists = list(dict.fromkeys(row["list"] for row in rows))
    figure = new_figure(4.6 * len(lists), 3.8)
    for axes, name in zip(figure.subplots(1, len(lists)), lists, strict=True):
        axes.margins(0.2)
        for row in (row for row in rows if row["list"] == name):
            place = float(row["seconds"]), float(row["AUC@10"])
            axes.plot(*place, "o")
            axes.annotate(row["method"], place, (0, -15), textcoords="offset points", ha="center")
        axes.set(xlim=(0, None), title=name, xlabel="seconds a pair", ylabel="AUC@10 (%)")
        axes.grid(alpha=0.3)
    save_figure(figure, PICTURE)


def main(runs: str | None = None) -> None:
    if runs is not None:
        rows = [measured(row, Path(runs, row["run"])) for row in read(RESULTS)]
        with RESULTS.open("w", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, [*rows[0]], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    draw_speed()
    for page in PAGES:
        page.write_text(TABLE.sub(table, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
