"""The examples in the docstrings of the public names, and what a notebook shows of results."""

import base64
import inspect
import textwrap
from pathlib import Path

import pytest

import linkplan

# A window, and minutes: their examples are written and compiled, and not run.
NOT_RUN = ("view", "demo")


def example(name: str) -> str:
    """Return the code of a public name's example, the last section of its docstring."""
    said = inspect.getdoc(getattr(linkplan, name)) or ""
    assert "\nExample::\n\n" in said, f"linkplan.{name} has no example"
    return textwrap.dedent(said.split("\nExample::\n\n")[1])


@pytest.mark.slow
@pytest.mark.parametrize("name", linkplan.__all__)
def test_an_example_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    code = compile(example(name), f"<example of {name}>", "exec")
    if name not in NOT_RUN:
        exec(code, {"linkplan": linkplan})


# Cells, of which all but the first show something; tests/test_pages.py runs the lines that the README shows first.
SHOWN = (
    "import linkplan; plan = linkplan.plan('knee-reach')",
    "plan",
    "plan.plot()",
    "linkplan.check('slider-crank').plot('slider-crank.png')",
    "linkplan.render(plan, 'reach.gif', size_px=(160, 120), fps=5.0)",
    "linkplan.report(plan, 'reach.html')",
)


def outputs_of(cells, folder: Path) -> list:
    """Return what the cells of a notebook show as their results, by kind, in a kernel of its own."""
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    nbclient.NotebookClient(notebook, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    return [output.data for cell in notebook.cells for output in cell.outputs if output.output_type == "execute_result"]


@pytest.mark.slow
def test_figures_films_and_pages_show_themselves_in_a_fresh_kernel(tmp_path):
    """Without `%matplotlib inline`, which would choose a backend for every figure."""
    table, *shown = outputs_of(SHOWN, tmp_path)
    assert "<table" in table["text/html"]
    assert [set(data) - {"text/plain"} for data in shown] == [{"image/png"}, {"image/png"}, {"text/html"}, {"text/html"}]
    assert base64.b64decode(shown[0]["image/png"]).startswith(b"\x89PNG")
    assert shown[2]["text/html"].startswith("<img ")
    assert "data:image/gif;base64," in shown[2]["text/html"]
    assert shown[3]["text/html"].startswith("<iframe srcdoc=")
    assert (tmp_path / "reach.html").is_file()
