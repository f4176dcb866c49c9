"""Completion scripts: what they know, what they cost, and that a shell obeys them."""

import argparse
import ast
import inspect
import shutil
import subprocess
import sys

import pytest

import linkplan
from linkplan.api.inputs import Source
from linkplan.cli.command_line import SHELLS, build_parser
from linkplan.cli.completion_command import completion_script
from linkplan.controllers.trackers.names import LINEAR
from linkplan.planner.problem.keys.key_table import FILES
from linkplan.studies.variations.experiment.design import DESIGNS
from tests.support.data import ROOT

# What is typed, and what must be among the answers.
TYPED = [
    ("linkplan pl", "plan"),
    ("linkplan plan knee-r", "knee-reach"),
    ("linkplan plan --ju", "--jumps"),
    ("linkplan check optimus-knee-l", "optimus-knee-linear"),
    ("linkplan check dra", "drawing.xml"),
    ("linkplan plan knee-reach --set motion.goal_d", "motion.goal_deg="),
    ("linkplan plan knee-reach --set robust.payload", "robust.payload_factor="),
    ("linkplan experiment knee-reach --set imperfections.coul", "imperfections.coulomb_friction="),
    ("linkplan track --tracker pd+", "pd+ff"),
    ("linkplan bode optimus-knee --no-m", "--no-measure"),
    ("linkplan export knee-reach --to key", "keyframes"),
    ("linkplan completion f", "fish"),
    ("linkplan experiment knee-reach --design la", "latin-hypercube"),
    ("linkplan compare knee-reach --trackers a", "all"),
    ("linkplan bode knee-reach --tracker l", "lqr"),
    ("linkplan schema b", "batch"),
]
BASH = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMPREPLY=()
_linkplan_without_blank linkplan "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}" 2>/dev/null
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_and_long_option_is_in_every_script(shell):
    script = completion_script(shell)
    (commands,) = (action.choices for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction))
    assert len(commands) > 10
    for name, command in commands.items():
        assert name in script
        for option in command._option_string_actions:
            assert option.lstrip("-") in script


@pytest.mark.parametrize(("name", "legal"), [("DESIGN", DESIGNS), ("LAW", LINEAR), ("KIND", tuple(FILES))])
def test_words_that_are_completed_are_those_that_are_legal(name, legal):
    script = completion_script("bash")
    assert f'_linkplan_{name.lower()}() {{\n  compgen -W "{" ".join(legal)}" -- "$1"\n}}' in script


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
@pytest.mark.parametrize(("line", "meant"), TYPED, ids=[line for line, _ in TYPED])
def test_bash_completes(line, meant, tmp_path):
    (tmp_path / "drawing.xml").write_text("", encoding="utf-8")
    (tmp_path / "script").write_text(completion_script("bash"), encoding="utf-8")
    words = line.split()
    done = subprocess.run(
        ["bash", "-c", BASH, "-", "./script", *words], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert meant in done.stdout.split()


@pytest.mark.skipif(shutil.which("fish") is None, reason="there is no fish here")
def test_fish_completes(tmp_path):
    (tmp_path / "drawing.xml").write_text("", encoding="utf-8")
    (tmp_path / "script").write_text(completion_script("fish"), encoding="utf-8")
    asked = "; ".join(f'echo "== {line}"; complete -C "{line}"' for line, _ in TYPED)
    done = subprocess.run(
        ["fish", "--no-config", "-c", f"source script; {asked}"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    answers = dict(block.split("\n", 1) for block in done.stdout.split("== ")[1:])
    for line, meant in TYPED:
        assert meant in [answer.split("\t")[0] for answer in answers[line].splitlines()], line


@pytest.mark.skipif(shutil.which("zsh") is None, reason="there is no zsh here")
def test_zsh_reads_the_script(tmp_path):
    (tmp_path / "script").write_text(completion_script("zsh"), encoding="utf-8")
    subprocess.run(["zsh", "-n", "script"], cwd=tmp_path, check=True)


def test_writing_a_script_loads_neither_solver_nor_simulator():
    code = "import sys; from linkplan.cli.main import main; main(['completion', 'bash']); print('LOADED', *sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    loaded = {name.split(".")[0] for name in said.rpartition("LOADED")[2].split()}
    assert "shtab" in loaded
    assert not loaded & {"casadi", "mujoco", "scipy", "matplotlib", "control", "numpy", "pyarrow"}


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
    public = {f"linkplan.api.{path.stem}" for path in (ROOT / "linkplan" / "api").glob("*.py")} | {
        "linkplan",
        "linkplan.api",
    }
    # Refusals in one line, and interrupts: what a process needs before any function is called.
    process = {"linkplan.models.errors", "linkplan.models.deadline"}
    seen = set()
    for path in (ROOT / "linkplan/cli").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                if name.split(".")[0] == "linkplan" and not name.startswith(("linkplan.cli", "linkplan.studies.output")):
                    seen.add(name)
                    assert name in public | process, f"{path.name} imports {name}"
    assert "linkplan" in seen
