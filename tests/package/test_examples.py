"""The examples in the docstrings of the public names run as they stand."""

import inspect
import textwrap

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
