"""`import linkplan`: a dozen names that load nothing before they are used; sentences without the command line's words."""

import ast
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import linkplan

ROOT = Path(__file__).resolve().parents[2]
PUBLIC = ROOT / "linkplan"
HEAVY = {"casadi", "mujoco", "numpy", "scipy", "matplotlib", "control"}
# Strings of the library that hold a dash and are no message: what is handed to a compiler, and commands to type.
NO_MESSAGES = {"functions.py", "typed_commands.py"}


def loaded_by(code: str) -> set[str]:
    """Return the top-level modules that a fresh interpreter has loaded after `code`."""
    said = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print('LOADED', *{{m.split('.')[0] for m in sys.modules}})"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    return set(said.rpartition("LOADED")[2].split())


def test_importing_linkplan_loads_nothing_heavy():
    loaded = loaded_by("import linkplan; dir(linkplan)")
    assert "linkplan" in loaded
    assert not loaded & HEAVY


def test_what_is_heavy_comes_with_the_first_name_that_needs_it():
    assert {"casadi", "mujoco", "numpy"} <= loaded_by("import linkplan; linkplan.load_mechanism")


def test_planning_loads_no_plots():
    loaded = loaded_by("import linkplan; linkplan.plan, linkplan.Problem, linkplan.Planner")
    assert "casadi" in loaded
    assert not loaded & {"matplotlib", "control"}


def test_a_planned_reach_loads_no_more_than_it_needs():
    run = "import os; os.environ['MUJOCO_GL'] = 'disable'; from linkplan.cli.main import main"
    modules = "', '.join(m for m in sys.modules if m.count('.') < 2)"
    code = f"{run}; main(['plan', 'knee-reach']); import sys; print({modules})"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()[-1]
    loaded = set(said.split(", "))
    assert "linkplan.planner" in loaded
    assert not loaded & {"numpy.random", "scipy.optimize", "scipy.sparse", "scipy.interpolate", "matplotlib", "secrets"}


def test_the_names_that_list_prints_load_neither_solver_nor_simulator():
    loaded = loaded_by("from linkplan.cli.main import main; main(['list'])")
    assert "linkplan" in loaded
    assert not loaded & {"casadi", "mujoco", "scipy", "matplotlib", "control"}


def test_the_module_runs_as_the_command_line():
    command = [sys.executable, "-m", "linkplan", "list"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "optimus-knee" in said
    assert "trackers: pd, pd+ff, lqr" in said


def test_a_name_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(AttributeError, match=r"no attribute 'solve'.*load_mechanism.*tune"):
        linkplan.solve  # noqa: B018


def test_editors_see_the_names_where_the_program_finds_them():
    tree = ast.parse((PUBLIC / "__init__.py").read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert seen == linkplan._HOMES
    assert sorted(seen) == sorted(linkplan.__all__)


def test_no_folder_of_the_package_bears_a_public_name():
    names = {path.stem for path in PUBLIC.iterdir()}
    assert {"api", "cli", "models"} <= names
    assert not names & set(linkplan.__all__)


def test_the_version_is_that_of_the_installed_package():
    assert re.fullmatch(r"\d+\.\d+.*", linkplan.__version__)


def test_messages_of_the_library_know_no_command_line():
    looked, found = 0, []
    for package in ("models", "planner", "controllers", "studies"):
        for path in (ROOT / package).rglob("*.py"):
            if path.is_relative_to(ROOT / "studies" / "cli") or path.name in NO_MESSAGES:
                continue
            tree = ast.parse(path.read_text(encoding="utf-8"))
            documents = {
                id(node.body[0].value)
                for node in ast.walk(tree)
                if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
                and node.body
                and isinstance(node.body[0], ast.Expr)
            }
            for node in ast.walk(tree):
                if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documents:
                    looked += 1
                    if re.search(r"(^|[\s'(])(--[a-z]|-o\b)", node.value):
                        found.append((path.name, node.value))
    assert looked > 1000
    assert not found


def test_positions_and_velocities_state_their_unit_in_their_names():
    from linkplan.controllers.reference import SampledReference
    from linkplan.controllers.rollout import Rollout
    from linkplan.controllers.trackers.tracker import TrackerWithMemory
    from linkplan.models.equations import Equations
    from linkplan.planner.certificate.certificate import Certificate
    from linkplan.planner.plan.plan import MotionTable
    from linkplan.planner.problem.extra import NamedInstant
    from linkplan.planner.search.replan import NextMotion
    from linkplan.studies.handover.transfer.transfer_result import TransferResult

    arrays = (SampledReference, Rollout, MotionTable, Certificate, NextMotion, NamedInstant)
    names = {f"{kind.__name__}.{name}" for kind in arrays for name in dir(kind)}
    methods = [vars(kind) for kind in (Equations, linkplan.Tracker, TrackerWithMemory, TransferResult)]
    functions = [one for members in methods for name, one in members.items() if inspect.isfunction(one) and name[0] != "_"]
    names |= {f"{one.__qualname__}.{name}" for one in functions for name in inspect.signature(one).parameters}
    quantities = [
        name
        for name in names
        if re.search(r"\.(pose|position|velocity|speed|acceleration|error|reference)[a-z_0-9]*$", name)
    ]
    shares = {"Certificate.velocity_residual"}
    assert len(quantities) > 30
    assert {name for name in quantities if not re.search(r"_(rad|deg|m)(_s2?)?$", name)} == shares


ASK = """
import os, sys
from linkplan.__main__ import main
sys.argv = ["linkplan", "list"]
main()
os.write(2, os.environ["OPENBLAS_NUM_THREADS"].encode())
"""


def test_a_command_uses_one_thread_unless_told_otherwise():
    given = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    for more, threads in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")):
        done = subprocess.run([sys.executable, "-c", ASK], env=given | more, capture_output=True, text=True, check=True)
        assert done.stderr == threads
