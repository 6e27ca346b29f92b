"""The code of the documentation runs: its pages and its notebooks.

In one process, since many of them use the same games: what one compiles, the next one has.
"""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pytest
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def blocks():
    """Python code blocks of the documentation, file by file."""
    files = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    found = {}
    for path in files:
        if path.exists():
            code = re.findall(
                r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), re.M | re.S
            )
            if code:
                found[path.relative_to(ROOT).as_posix()] = "\n".join(code)
    return found


@pytest.mark.parametrize("name", list(blocks()))
def test_documented_code_runs(name, tmp_path, monkeypatch):
    """All blocks of a file, one after the other, in one namespace."""
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks()[name], name, "exec"), {"__name__": "__main__"})


def test_there_is_documented_code():
    assert {
        "docs/tutorials/define_a_game.md",
        "docs/environments/intersection.md",
        "docs/tutorials/lane_change.md",
    } <= set(blocks())


FEWER = {"predictors": (("range(12)", "range(3)"), ("range(3)]", "range(1)]"))}
"""Fewer episodes than the notebook has."""


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 3


# IPython's own warnings are not ours.
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path, monkeypatch):
    """From top to bottom in one namespace; `make docs` runs them with Jupyter."""
    monkeypatch.chdir(tmp_path)
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] for cell in code)  # outputs are made, not stored
    sources = "\0".join(cell.source for cell in code)
    for many, few in FEWER.get(path.stem, ()):
        assert sources.count(many) == 1
        sources = sources.replace(many, few)
    shell, told, pictures = InteractiveShell(), "", 0
    for source in sources.split("\0"):
        with capture_output() as output:
            shell.run_cell(source).raise_error()
        told += output.stdout
        pictures += len(plt.get_fignums())
        plt.close("all")
    assert pictures
    assert told
