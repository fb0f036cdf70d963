"""Every notebook runs from top to bottom, asserts what it claims, and is kept with its outputs.

People read notebooks where nobody runs them: the outputs in the repository must be there, without errors, and small.
"""

import os
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(path.stem for path in FOLDER.glob("*.ipynb"))

TOPICS = (
    "accuracy",
    "bushing",
    "controllers",
    "cycles",
    "design_optimisation",
    "dry_contact",
    "equations",
    "four_joints",
    "from_a_csv_to_a_joint_model",
    "go_on",
    "hard_cases",
    "identification",
    "lubrication",
    "networks",
    "rig",
    "suspension",
    "sweep",
    "tolerances",
    "your_own_mechanism",
)
"""What there must be a notebook about."""

LARGEST = 400 * 1024
"""Bytes of a notebook with its pictures."""

FAST = ("bushing", "dry_contact")
"""Notebooks that take half a minute and are not the subject of other tests; the others are slow tests."""

KEPT = ("image/png", "text/plain", "text/html", "application/vnd.jupyter.widget-view+json")
"""Kinds of outputs that may be kept; anything else is a surprise."""


def read(name: str) -> nbformat.NotebookNode:
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def code_of(notebook) -> list:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def outputs_of(notebook) -> list:
    return [output for cell in code_of(notebook) for output in cell.outputs]


def environment() -> dict[str, str]:
    """The kernel's; the cache is that of the tests."""
    search = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return {
        **os.environ,
        "SPHEREJAX_QUIET": "1",  # says what it compiles, unless the cache has it already
        "PYTHONPATH": search,
        "TF_CPP_MIN_LOG_LEVEL": "3",  # XLA's alarm for compilations on a busy machine
    }


def test_there_is_a_notebook_about_everything():
    assert tuple(NOTEBOOKS) == TOPICS


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in FAST else [pytest.mark.slow]) for name in NOTEBOOKS]
)
def test_notebook_runs(name):
    notebook = read(name)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(FOLDER)}}).execute(env=environment())
    assert all(cell.execution_count for cell in code_of(notebook)), "a cell was skipped"
    assert not [output.text for output in outputs_of(notebook) if output.get("name") == "stderr"], "a warning"
    # The same kinds of outputs in the same places as those that are kept.
    kept = [kinds_of(cell) for cell in code_of(read(name))]
    assert [kinds_of(cell) for cell in code_of(notebook)] == kept, "the kept outputs are not those of this code"


def kinds_of(cell) -> set[str]:
    """What a cell shows; how printed text is cut into pieces is chance."""
    return {kind for output in cell.outputs for kind in output.get("data", {"text": None})}


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebook_is_kept_with_its_outputs(name):
    notebook = read(name)
    outputs = outputs_of(notebook)
    assert all(cell.execution_count for cell in code_of(notebook)), "a cell was not run before it was kept"
    counts = [cell.execution_count for cell in code_of(notebook)]
    assert counts == list(range(1, len(counts) + 1)), "it was not run from top to bottom"
    assert not [output for output in outputs if output.output_type == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    data = [output.data for output in outputs if "data" in output]
    assert {kind for each in data for kind in each} <= set(KEPT)
    assert sum("image/png" in each for each in data) >= 2, "a notebook shows pictures"
    assert (FOLDER / f"{name}.ipynb").stat().st_size < LARGEST


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebook_tells_a_story(name):
    cells = read(name).cells
    assert cells[0].source.startswith("# ")
    assert "**Question.**" in cells[0].source
    assert "## What to conclude" in cells[-2].source
    assert len(re.findall(r"^\s*assert ", cells[-1].source, re.MULTILINE)) >= 5, "it ends with its claims as numbers"


def test_one_notebook_has_the_view_that_turns():
    shown = [cell for name in NOTEBOOKS for cell in code_of(read(name)) if "sj.view(" in cell.source]
    assert shown
    assert all("application/vnd.jupyter.widget-view+json" in kinds_of(cell) for cell in shown)


def test_the_index_names_every_notebook():
    found = re.findall(r"\((\w+)\.ipynb\)", (FOLDER / "README.md").read_text())
    assert sorted(found) == NOTEBOOKS


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebook_says_nothing_about_the_machine_it_was_run_on(name):
    text = (FOLDER / f"{name}.ipynb").read_text()
    assert not re.search(r"(/work|/home|/root|/tmp|/Users)\b", text)
