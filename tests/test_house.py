"""The house itself: which way imports run, how numbers are named, what ships, and that help is quick to answer."""

import ast
import graphlib
import itertools
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.sources import MODULES, PACKAGES, PUBLIC, ROOT, SOURCES, arrows, imports, named_numbers, room_of

# Of the planner, controllers know the trajectory only.
CONTROLLERS_MAY = {"planner.trajectory"}
# The rooms of each package from the ground up: a room imports rooms before it, never one after it. A file that stands in
# its package's own folder is a room of its own.
ROOMS = {
    "models": (
        "errors", "extras", "deadline", "work_folders", "compiled", "reading", "catalogue", "payload", "kinematics",
        "symbolic_model", "foreign", "external_forces", "ground", "selection", "library", "digest",
        "tree", "closure", "reduction", "actuation", "parameters", "audit",
        "coordinate_choice", "equations", "mechanism_html", "mechanism", "selected_model", "poses", "transfer", "guide",
    ),
    "planner": (
        "transcription", "trajectory", "files", "problem", "limits", "certificate", "proof", "solvers", "refinement",
        "plan", "closed_chain", "phase_plane", "search",
    ),
    "controllers": (
        "reference", "linearisation", "integrator", "sampling", "trackers", "rollout", "imperfections",
        "feedback_loop", "rigid_plant", "mujoco_plant", "phases", "simulate", "controls", "playback",
    ),
    "studies": (
        "output", "check", "compare", "variations", "feedback", "render", "handover", "report", "explore", "demo",
    ),
}  # fmt: skip
TRANSCRIPTION_MAY = {
    "linkplan.models.compiled.functions",
    "linkplan.models.deadline",
    "linkplan.models.errors",
    "linkplan.models.reduction.elimination",  # symbolic solution of A x = b
}


def test_every_package_has_sources_to_look_at():
    assert {path.relative_to(ROOT).parts[0] for path in SOURCES} == {*PACKAGES, "linkplan"}
    assert sum(arrows().values()) > 300  # imports are read: the tests below cannot pass for want of any


def test_every_room_is_listed_and_says_what_comes_in_and_what_goes_out():
    for package, rooms in ROOMS.items():
        folders = {path.parent.name for path in (ROOT / package).glob("*/__init__.py")}
        files = {path.stem for path in (ROOT / package).glob("*.py")} - {"__init__"}
        assert set(rooms) == folders | files, package
        for folder in folders:
            said = ast.get_docstring(ast.parse((ROOT / package / folder / "__init__.py").read_text(encoding="utf-8")))
            assert said, folder
            if folder != "demo":
                assert "In: " in said, folder
                assert "Out: " in said, folder


def test_the_guide_for_developers_has_every_room_in_its_tables():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for package, rooms in ROOMS.items():
        (table,) = re.findall(rf"^\| {package}: [^\n]*\n((?:\|[^\n]*\n)+)", text, flags=re.MULTILINE)
        listed = re.findall(r"`(\w+)`", " ".join(row.split("|")[1] for row in table.splitlines()))
        assert sorted(listed) == sorted(rooms), package


@pytest.mark.parametrize("module", sorted(MODULES))
def test_imports_run_downwards(module):
    ours = {name for name in imports(MODULES[module]) if name.split(".")[0] == "linkplan"}
    assert ours <= set(MODULES), f"{module} imports what is not there: {sorted(ours - set(MODULES))}"
    if room_of(module) is None:
        return
    package, room = room_of(module)
    for name in ours:
        assert room_of(name) is not None, f"{module} imports the public package: {name}"
        other_package, other = room_of(name)
        assert PACKAGES.index(other_package) <= PACKAGES.index(package), f"{module} imports {name}"
        if other_package == package and other != room:
            rooms = ROOMS[package]
            assert rooms.index(other) < rooms.index(room), f"{module} imports {name}, which stands above it"
        if package == "controllers" and other_package == "planner":
            assert f"planner.{other}" in CONTROLLERS_MAY, f"{module} imports {name}"


def test_no_imports_go_in_a_circle():
    graph = {name: {other for other in imports(path) if other in MODULES} for name, path in MODULES.items()}
    assert len(list(graphlib.TopologicalSorter(graph).static_order())) == len(MODULES)


def test_no_imports_between_the_folders_of_a_room_go_in_a_circle():
    inner = 0
    for package, rooms in ROOMS.items():
        for room in rooms:
            inside = {name: path.parent for name, path in MODULES.items() if room_of(name) == (package, room)}
            graph = {folder: set() for folder in inside.values()}
            for name, folder in inside.items():
                graph[folder] |= {inside[other] for other in imports(MODULES[name]) if other in inside} - {folder}
            inner += sum(map(len, graph.values()))
            assert len(list(graphlib.TopologicalSorter(graph).static_order())) == len(graph)
    assert inner > 5


def test_the_transcription_knows_no_mechanisms():
    for path in (ROOT / "planner" / "transcription").glob("*.py"):
        outside = {n for n in imports(path) if n.startswith("linkplan.") and ".transcription" not in n}
        assert outside <= TRANSCRIPTION_MAY, path


@pytest.mark.parametrize("package", ["models", "planner"])
def test_the_lower_packages_know_no_plots_and_the_planner_no_simulator(package):
    banned = {"matplotlib", "control"} | ({"mujoco"} if package == "planner" else set())
    for path in (ROOT / package).rglob("*.py"):
        assert not {name.split(".")[0] for name in imports(path)} & banned, path


def test_relative_imports_are_not_used():
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        assert not [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level], path


def test_names_of_numbers_have_two_words_or_more():
    named = {path: named_numbers(path) for path in SOURCES}
    assert any(named.values())
    short = {str(path.relative_to(ROOT)): name for path, names in named.items() for name in names if "_" not in name[1:]}
    assert not short


def test_no_test_imports_from_another_test_module():
    for path in (ROOT / "tests").rglob("*.py"):
        others = {name for name in imports(path) if any(part.startswith("test_") for part in name.split("."))}
        assert not others, f"{path.relative_to(ROOT)} imports {sorted(others)}"


def test_the_only_links_of_the_public_package_lead_to_the_four_folders():
    links = {path.name: path.readlink() for path in PUBLIC.rglob("*") if path.is_symlink()}
    assert links == {package: Path("..", package) for package in PACKAGES}


def test_public_functions_do_not_import_the_command_line():
    for path in (PUBLIC / "api").glob("*.py"):
        assert not [name for name in imports(path) if name.startswith("linkplan.cli")], path


def test_imports_lead_into_the_tree_from_the_tree_and_from_elsewhere(tmp_path):
    code = "import linkplan, linkplan.planner; print(linkplan.__file__, linkplan.planner.__file__, sep='\\n')"
    expected = [str(ROOT / "linkplan" / "__init__.py"), str(ROOT / "linkplan" / "planner" / "__init__.py")]
    for folder in (ROOT, tmp_path):
        said = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True).stdout
        assert said.splitlines() == expected, folder


def test_all_data_files_are_listed_in_the_project_file():
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    for name, patterns in tool["package-data"].items():
        folder = ROOT.joinpath(*name.split("."))
        shipped = set(itertools.chain.from_iterable(folder.glob(pattern) for pattern in patterns))
        assert shipped == {path for path in folder.iterdir() if path.is_file() and path.suffix != ".py"}


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from linkplan.cli.main import main; main(['plan', '--help']);"
        "heavy = {'casadi', 'mujoco', 'matplotlib', 'control', 'scipy', 'numpy'} & set(sys.modules);"
        "print('HEAVY', sorted(heavy))"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "usage: linkplan plan" in said
    assert said.rstrip().endswith("HEAVY []")


@pytest.mark.parametrize("length", ["long", "hardest"])
def test_every_listed_test_is_there(length):
    for name in (ROOT / "tests" / f"{length}.txt").read_text(encoding="utf-8").splitlines():
        file, test = name.partition("[")[0].split("::")
        assert f"def {test}(" in (ROOT / file).read_text(encoding="utf-8"), name
