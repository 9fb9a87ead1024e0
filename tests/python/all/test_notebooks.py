"""The notebooks run from the first cell to the last, and print what they have printed."""

import nbclient
import nbformat
import pytest

from conftest import ROOT

FOLDER = ROOT / "api/python/examples"


def printed(notebook):
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [[out.text for out in cell.outputs if out.output_type == "stream"] for cell in cells]


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.ipynb")))
def test_a_notebook_runs(server, monkeypatch, name):
    monkeypatch.setenv("MLSWARP_URL", server.address)
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    before = printed(notebook)
    client = nbclient.NotebookClient(
        notebook, timeout=120, resources={"metadata": {"path": str(FOLDER)}}
    )
    client.execute()
    assert any(cell.get("outputs") for cell in notebook.cells)
    assert printed(notebook) == before
