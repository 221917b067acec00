"""The tutorial runs from top to bottom, and says what it is said to."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

TUTORIAL = Path(__file__).resolve().parents[1] / "docs" / "tutorial.ipynb"


def texts(notebook: nbformat.NotebookNode) -> list[str]:
    """What each cell of code printed."""
    return [
        "".join(one.get("text", "") for one in cell.outputs)
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def pictures(notebook: nbformat.NotebookNode) -> int:
    """How many figures the cells show."""
    outputs = [one for cell in notebook.cells for one in cell.get("outputs", [])]
    return sum("image/jpeg" in one.get("data", {}) for one in outputs)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> nbformat.NotebookNode:
    """The notebook, run afresh. A cell that fails ends it with its error."""
    notebook = nbformat.read(TUTORIAL, as_version=4)
    resources = {"metadata": {"path": str(tmp_path_factory.mktemp("tutorial"))}}
    NotebookClient(notebook, timeout=600, resources=resources).execute()
    return notebook


def test_every_cell_runs_and_the_results_are_good(run: nbformat.NotebookNode) -> None:
    pose, errors, _, _, own, bench, _, batch, database = texts(run)
    assert pose.startswith("ok ")
    assert all(float(value) < 0.5 for value in re.findall(r"is ([\d.]+) deg", errors))
    assert own.startswith("ok ")
    rows = [line.split() for line in bench.splitlines() if line.startswith(("dgcm-lite0", "sift"))]
    assert [row[1] for row in rows] == ["10", "10"]
    assert "1 pair" in batch and "2 images" in batch
    assert "['1.png', '2.png']" in database
    assert int(database.splitlines()[1].split()[0]) > 100
    assert pictures(run) == 3


def test_the_stored_results_are_of_a_whole_run(run: nbformat.NotebookNode) -> None:
    """In order, without an error, and without a path of the machine that they were made on."""
    stored = nbformat.read(TUTORIAL, as_version=4)
    cells = [cell for cell in stored.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == [*range(1, len(cells) + 1)]
    assert pictures(stored) == pictures(run)
    assert not re.search(r"/(home|root|tmp|work|Users)/", "".join(texts(stored)))
    assert TUTORIAL.stat().st_size < 1_500_000
