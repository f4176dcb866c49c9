"""One front door: every command is a public function with the same names and defaults, and imports nothing behind it."""

import argparse
import ast
import inspect

import pytest

import linkplan
from linkplan.inputs import Source
from linkplan.studies.cli.command_line import build_parser
from tests.support.data import ROOT

# Options on showing and writing only: where the result goes and what of it is printed.
SHOWING = {"json", "output", "report", "parquet", "jumps", "all", "help"}
# Options that say how the first argument is read: `load_mechanism`, `Problem.from_file` and `read_plan` take them in Python.
READING = {"set", "keep", "fix_base", "lock", "keyframe", "drive", "anyway"}
# Parameters that stand for such options: the place of the result, --set tracking.KEY and --set imperfections.KEY, and what a
# process has of its own: its progress, its environment, its errors.
OF_PYTHON = {"folder", "path", "tracking", "imperfections", "progress", "mujoco_gl", "tell"}
# Commands on the command line itself.
OWN = {"list", "completion"}


def commands() -> dict[str, argparse.ArgumentParser]:
    (actions,) = [a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return dict(actions.choices)


def options_of(parser: argparse.ArgumentParser) -> dict[str, argparse.Action]:
    return {action.dest: action for action in parser._actions if action.dest not in SHOWING}


def test_there_are_commands_to_look_at():
    assert len(commands()) > 18
    assert set(commands()) - OWN <= set(linkplan.__all__)


def _frozen(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


@pytest.mark.parametrize("name", sorted(set(commands()) - OWN))
def test_options_have_the_names_and_defaults_of_the_functions_parameters(name):
    parameters = dict(inspect.signature(getattr(linkplan, name)).parameters)
    options = options_of(commands()[name])
    if not READING - {"set", "anyway"} <= set(parameters):
        options = {dest: action for dest, action in options.items() if dest not in READING}
    else:
        options = {dest: action for dest, action in options.items() if dest not in ("set", "anyway")}
    assert set(options) == set(parameters) - OF_PYTHON - SHOWING, name
    for dest, action in options.items():
        default = parameters[dest].default
        is_needed = action.required and action.nargs is None
        assert (default is inspect.Parameter.empty) == is_needed, dest
        if not is_needed:
            assert _frozen(action.default) == _frozen(default), dest


def test_a_source_has_the_options_that_say_how_an_argument_is_read():
    assert set(inspect.signature(Source).parameters) == {"name", "settings", "selection", "anyway"}
    loading = set(inspect.signature(linkplan.load_mechanism).parameters)
    assert READING - {"set", "anyway"} <= loading


def test_the_command_line_imports_the_public_package_and_renderers_alone():
    public = {f"linkplan.{path.stem}" for path in (ROOT / "studies" / "package").glob("*.py")} | {"linkplan"}
    # Refusals in one line, and interrupts: what a process needs before any function is called.
    process = {"linkplan.models.errors", "linkplan.models.deadline"}
    seen = set()
    for path in (ROOT / "studies" / "cli").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                if name.split(".")[0] == "linkplan" and not name.startswith(
                    ("linkplan.studies.cli", "linkplan.studies.output")
                ):
                    seen.add(name)
                    assert name in public | process, f"{path.name} imports {name}"
    assert "linkplan" in seen
