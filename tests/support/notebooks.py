"""The notebooks of docs/notebooks: cells from a Python file in the percent format, run in a kernel and kept as .ipynb."""

import base64
import re
from io import BytesIO
from pathlib import Path

from PIL import Image

# The largest saved notebook, so that a browser shows it at once.
MOST_BYTES = 400_000
_METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def cells_of(source: Path) -> list[tuple[str, str]]:
    """Return the cells of a Python file: ("markdown" or "code", text)."""
    _, *parts = re.split(r"^# %%(.*)\n", source.read_text(encoding="utf-8"), flags=re.MULTILINE)
    found = []
    for head, body in zip(parts[::2], parts[1::2], strict=True):
        if "[markdown]" in head:
            found.append(("markdown", re.sub(r"^# ?", "", body.strip(), flags=re.MULTILINE)))
        else:
            found.append(("code", body.strip()))
    return found


def executed(source: Path, folder: Path):
    """Return the notebook of a Python file, run in a kernel of its own in a folder."""
    import nbclient
    import nbformat

    make = {"markdown": nbformat.v4.new_markdown_cell, "code": nbformat.v4.new_code_cell}
    cells = [make[kind](text, id=f"cell-{k}") for k, (kind, text) in enumerate(cells_of(source))]
    notebook = nbformat.v4.new_notebook(cells=cells, metadata=_METADATA)
    resources = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(notebook, kernel_name="python3", resources=resources, record_timing=False, timeout=600).execute()
    notebook.metadata = _METADATA  # without this machine's versions
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if picture := output.get("data", {}).get("image/png"):
                output.data["image/png"] = _smaller(picture)
    return notebook


def _smaller(picture: str) -> str:
    """Return a picture with 64 colours, a third of the letters."""
    small = BytesIO()
    Image.open(BytesIO(base64.b64decode(picture))).convert("RGB").quantize(64).save(small, format="PNG", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


def printed(notebook) -> list[str]:
    """Return what each code cell of a notebook printed."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return ["".join(output.text for output in cell.outputs if output.output_type == "stream") for cell in cells]


def pictures(notebook) -> list[int]:
    """Return how many pictures each code cell of a notebook shows."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [sum("image/png" in output.get("data", {}) for output in cell.outputs) for cell in cells]
