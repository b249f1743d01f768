"""Every notebook runs from top to bottom without an error or a warning, and is committed with the outputs
that it shows."""

import re
from pathlib import Path

import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
TIMEOUT = 900  # seconds a cell, on a busy machine
LARGEST = 1_000_000  # bytes: a committed notebook stays in every clone for ever
MACHINE = re.compile(r"/home/|/root/|/Users/|/tmp/|[A-Z]:\\|site-packages")  # of whoever ran it last

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code" and cell.source.strip()]


def texts(cell):
    """What a cell printed or showed, without its pictures."""
    for output in cell.outputs:
        yield output.get("text", "") + "".join(
            str(text) for kind, text in output.get("data", {}).items() if "image" not in kind
        )


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.study
@every_notebook
# Some versions of Jupyter's messaging libraries warn of their own future (event loops, clocks) in this
# process, which runs none of the project's code here. What the notebook's kernel warns of arrives as an
# output on stderr, and fails below.
@pytest.mark.filterwarnings(
    "default::DeprecationWarning:(jupyter_client|nbclient|zmq|ipykernel|traitlets|tornado)"
)
def test_runs(path):
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(path.parent)}}
    NotebookClient(
        notebook, timeout=TIMEOUT, kernel_name="python3", resources=resources
    ).execute()  # raises on an error
    for cell in code_cells(notebook):
        said = [
            output.text
            for output in cell.outputs
            if output.output_type == "stream" and output.name == "stderr"
        ]
        assert not said, f"{path.name}, in the cell that begins {cell.source[:60]!r}: {''.join(said)}"


@every_notebook
def test_is_committed_as_it_ran(path):
    notebook = nbformat.read(path, as_version=4)
    cells = code_cells(notebook)
    assert notebook.metadata.kernelspec.name == "python3"
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1)), (
        "run all cells, once, from the top"
    )
    outputs = [output for cell in cells for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not [
        output for output in outputs if output.output_type == "error" or output.get("name") == "stderr"
    ]
    assert path.stat().st_size < LARGEST


@every_notebook
def test_outputs_name_no_machine(path):
    for cell in code_cells(nbformat.read(path, as_version=4)):
        for text in texts(cell):
            assert not MACHINE.search(text), text
