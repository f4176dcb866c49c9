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
from linkplan.api.names import SELECTION, SHELLS
from linkplan.cli import signatures
from linkplan.cli.command_line import build_parser
from linkplan.cli.completion_command import completion_command
from linkplan.cli.option_kinds import KINDS
from linkplan.controllers.trackers.names import LINEAR
from linkplan.planner.problem.keys.key_table import FILES
from linkplan.studies.variations.experiment.experiment import DESIGNS
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
    script = completion_command(shell)
    (commands,) = (action.choices for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction))
    assert len(commands) > 10
    for name, command in commands.items():
        assert name in script
        for option in command._option_string_actions:
            assert option.lstrip("-") in script


@pytest.mark.parametrize(("name", "legal"), [("DESIGN", DESIGNS), ("LAW", LINEAR), ("KIND", tuple(FILES))])
def test_words_that_are_completed_are_those_that_are_legal(name, legal):
    script = completion_command("bash")
    assert f'_linkplan_{name.lower()}() {{\n  compgen -W "{" ".join(legal)}" -- "$1"\n}}' in script


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
@pytest.mark.parametrize(("line", "meant"), TYPED, ids=[line for line, _ in TYPED])
def test_bash_completes(line, meant, tmp_path):
    (tmp_path / "drawing.xml").write_text("", encoding="utf-8")
    (tmp_path / "script").write_text(completion_command("bash"), encoding="utf-8")
    words = line.split()
    done = subprocess.run(
        ["bash", "-c", BASH, "-", "./script", *words], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert meant in done.stdout.split()


@pytest.mark.skipif(shutil.which("fish") is None, reason="there is no fish here")
def test_fish_completes(tmp_path):
    (tmp_path / "drawing.xml").write_text("", encoding="utf-8")
    (tmp_path / "script").write_text(completion_command("fish"), encoding="utf-8")
    asked = "; ".join(f'echo "== {line}"; complete -C "{line}"' for line, _ in TYPED)
    done = subprocess.run(
        ["fish", "--no-config", "-c", f"source script; {asked}"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    answers = dict(block.split("\n", 1) for block in done.stdout.split("== ")[1:])
    for line, meant in TYPED:
        assert meant in [answer.split("\t")[0] for answer in answers[line].splitlines()], line


@pytest.mark.skipif(shutil.which("zsh") is None, reason="there is no zsh here")
def test_zsh_reads_the_script(tmp_path):
    (tmp_path / "script").write_text(completion_command("zsh"), encoding="utf-8")
    subprocess.run(["zsh", "-n", "script"], cwd=tmp_path, check=True)


def test_writing_a_script_loads_neither_solver_nor_simulator():
    code = "import sys; from linkplan.cli.main import main; main(['completion', 'bash']); print('LOADED', *sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    loaded = {name.split(".")[0] for name in said.rpartition("LOADED")[2].split()}
    assert "shtab" in loaded
    assert not loaded & {"casadi", "mujoco", "scipy", "matplotlib", "control", "numpy", "pyarrow"}


def test_every_command_is_a_public_function_with_a_sentence_on_every_option():
    found = signatures.commands()
    assert len(found) > 18
    assert set(found) - {"list", "completion"} <= set(linkplan.__all__)
    for command in found.values():
        for parameter in command.parameters:
            assert parameter.text, f"{command.name} {parameter.name}"


def test_what_is_read_from_the_source_is_what_python_has():
    for name, command in signatures.commands().items():
        if name not in ("list", "completion"):
            has = inspect.signature(getattr(linkplan, name)).parameters
            for parameter in command.parameters:
                default = has[parameter.name].default
                assert (default is inspect.Parameter.empty) == (not parameter.is_optional)
                assert not parameter.is_optional or default == parameter.default, f"{name} {parameter.name}"


def test_options_of_one_name_in_the_help_are_completed_by_the_same_words():
    words = {}
    for kind in KINDS.values():
        if kind.words or kind.patterns or kind.folders:
            found = (set(kind.words), kind.patterns)
            assert words.setdefault(kind.metavar, found) == found, kind.metavar


def test_a_source_has_the_options_that_say_how_an_argument_is_read():
    assert set(inspect.signature(Source).parameters) == {"name", "settings", "selection", "anyway"}
    assert set(SELECTION) <= set(inspect.signature(linkplan.load_mechanism).parameters)


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
