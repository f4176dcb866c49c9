"""The house itself: import arrows, file sizes, what ships, and that help is quick to answer."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("models", "planner", "controllers", "studies")
# package: what it may import of the others (models <- planner <- controllers <- studies)
ARROWS = {
    "models": {"models"},
    "planner": {"models", "planner"},
    "controllers": {"models", "planner", "controllers"},
    "studies": set(PACKAGES),
}
# Of the planner, controllers know the trajectory only.
CONTROLLERS_MAY = {"planner.trajectory"}
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def _imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(node.module)
    return found


def test_every_package_has_sources_to_look_at():
    assert {path.relative_to(ROOT).parts[0] for path in SOURCES} == set(PACKAGES)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_follow_the_arrows(path):
    package = path.relative_to(ROOT).parts[0]
    ours = {name for name in _imports(path) if name.split(".")[0] in PACKAGES}
    against = {name for name in ours if name.split(".")[0] not in ARROWS[package]}
    assert not against, f"{path.relative_to(ROOT)} imports {sorted(against)}"
    if package == "controllers":
        assert {name for name in ours if name.startswith("planner")} <= CONTROLLERS_MAY


@pytest.mark.parametrize("package", ["models", "planner"])
def test_the_lower_packages_know_no_plots_and_the_planner_no_simulator(package):
    banned = {"matplotlib", "control"} | ({"mujoco"} if package == "planner" else set())
    for path in (ROOT / package).rglob("*.py"):
        assert not {name.split(".")[0] for name in _imports(path)} & banned, path


def test_relative_imports_are_not_used():
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        assert not [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level], path


def test_no_file_is_longer_than_four_hundred_lines():
    long = {str(p.relative_to(ROOT)): n for p in SOURCES if (n := len(p.read_text(encoding="utf-8").splitlines())) > 400}
    assert not long


def test_packages_and_data_are_listed_in_the_project_file():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    listed = set(project["tool"]["setuptools"]["packages"])
    with_code = {".".join(path.parent.relative_to(ROOT).parts) for path in SOURCES}
    assert listed == with_code
    assert "mjcf/*.xml" in project["tool"]["setuptools"]["package-data"]["models"]
    assert "problems/*.toml" in project["tool"]["setuptools"]["package-data"]["planner"]


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from studies.cli import main; main(['plan', '--help']);"
        "heavy = {'casadi', 'mujoco', 'matplotlib', 'control', 'scipy'} & set(sys.modules);"
        "print('HEAVY', sorted(heavy))"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True).stdout
    assert "usage: linkplan plan" in said
    assert said.rstrip().endswith("HEAVY []")
