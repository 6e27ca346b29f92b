"""The notebooks of the documentation run from top to bottom."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "docs" / "notebooks").glob("*.ipynb"))
PATIENCE = 600
"""For one cell where machines are slow, s."""


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 3


# Jupyter's own warnings (sockets that it leaves to the garbage collector) are not ours.
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] for cell in code)  # outputs are made, not stored
    NotebookClient(notebook, timeout=PATIENCE, resources={"metadata": {"path": tmp_path}}).execute()
    kinds = [out.output_type for cell in code for out in cell.outputs]
    assert "display_data" in kinds  # a picture
    assert "stream" in kinds  # a number
