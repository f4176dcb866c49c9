"""The wheel: built, installed into a fresh environment, and run from a folder whose files bear our packages' names."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Our own sub-packages: a file of a user's that is called so is the user's.
INNER = ("models", "planner", "controllers", "studies")
# The first setuptools that reads the licence as it is written in pyproject.toml.
SETUPTOOLS = (77,)

FIRST_OF_THE_DEMO = """
import linkplan
from linkplan.studies.demo.demo import PLANNED
print(linkplan.plan(PLANNED[0]))
"""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Return the wheel of a copy of the sources, so that nothing is built beside them."""
    place = tmp_path_factory.mktemp("wheel")
    for name in INNER:
        shutil.copytree(ROOT / name, place / "source" / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "linkplan", place / "source" / "linkplan", symlinks=True)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, place / "source")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(place), str(place / "source")]
    try:
        recent = tuple(int(part) for part in metadata.version("setuptools").split(".")[:1]) >= SETUPTOOLS
    except metadata.PackageNotFoundError:
        recent = False
    done = subprocess.run(command + ["--no-build-isolation"] * recent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return next(place.glob("linkplan-*.whl"))


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory):
    """Return the interpreter of a fresh environment: the wheel, and this environment's packages for what it depends on."""
    place = tmp_path_factory.mktemp("fresh")
    venv.create(place, with_pip=False)
    fresh = place / ("Scripts" if os.name == "nt" else "bin") / "python"
    command = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        str(fresh),
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        str(wheel),
    ]
    subprocess.run(command, check=True, capture_output=True, text=True)
    base = {"base": str(place), "platbase": str(place)}
    packages = Path(sysconfig.get_path("purelib", scheme="venv", vars=base))
    # A folder that is named in a .pth file is searched last, and its own .pth files, as an editable install's, are not read.
    (packages / "others.pth").write_text(
        "\n".join({sysconfig.get_path(k) for k in ("purelib", "platlib")}), encoding="utf-8"
    )
    return fresh


@pytest.fixture
def hostile(tmp_path):
    """Return a folder that holds nothing but files with our packages' names, none of which may be imported."""
    for name in INNER:
        (tmp_path / f"{name}.py").write_text(
            "raise SystemExit('a file of the working folder was imported')\n", encoding="utf-8"
        )
    return tmp_path


def run(python, folder, *arguments):
    """Return the finished process of the fresh interpreter in a folder, which is first on its path."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    return subprocess.run(
        [str(python), *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_a_wheel_has_one_name_at_the_top_and_all_modules_below_it(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"linkplan"}
    kept = {name for name in names if name.endswith((".py", ".xml", ".toml"))}
    assert "linkplan/py.typed" in names
    for package in INNER:
        for source in [*(ROOT / package).rglob("*.py"), *(ROOT / package).rglob("*.xml"), *(ROOT / package).rglob("*.toml")]:
            assert f"linkplan/{source.relative_to(ROOT).as_posix()}" in kept
    for source in [path for folder in (".", "api", "cli") for path in (ROOT / "linkplan" / folder).glob("*.py")]:
        assert source.relative_to(ROOT).as_posix() in kept


@pytest.mark.parametrize("name", INNER)
def test_no_sub_package_is_importable_at_the_top(python, tmp_path, name):
    assert run(python, tmp_path, "-c", f"import linkplan.{name}").returncode == 0
    refused = run(python, tmp_path, "-c", f"import {name}")
    assert f"No module named '{name}'" in refused.stderr


def test_the_fresh_environment_runs_the_wheel_and_not_the_sources(python, hostile):
    said = run(python, hostile, "-c", "import linkplan.planner; print(linkplan.planner.__file__)").stdout
    assert Path(said.strip()).is_relative_to(python.parent.parent)
    assert run(python, hostile, "-c", "import models").stderr.strip() == "a file of the working folder was imported"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-m", "linkplan", "list"], "trackers: pd, pd+ff, lqr"),
        (["-m", "linkplan", "check", "optimus-knee"], "optimus-knee: 1 degree of freedom"),
        (["-m", "linkplan", "plan", "knee-reach", "-o", "reach"], "certificate: passed"),
        (["-c", FIRST_OF_THE_DEMO], "knee-sine: optimal"),
    ],
)
def test_commands_run_beside_files_with_our_packages_names(python, hostile, arguments, words):
    done = run(python, hostile, *arguments)
    assert done.returncode == 0, done.stderr
    assert words in done.stdout
    assert (hostile / "reach" / "plan.png").is_file() == ("plan" in arguments)


def test_the_command_itself_is_installed(python, hostile):
    done = run(python.parent / "linkplan", hostile, "list")
    assert done.returncode == 0, done.stderr
    assert "optimus-knee" in done.stdout
