"""What all tests have: a cache of compiled functions and signals of their own, and the command line."""

import json
import os
import signal
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from linkplan.cli.main import main
from linkplan.models.catalogue import MODELS
from linkplan.planner.problem import build
from linkplan.studies.output import figure as figures

DRAW, LAY_OUT = Figure.savefig, figures._lay_out
# As many mechanisms are kept as a file's tests have at most, not those of a whole run.
MOST_MECHANISMS = 64


# The tests that take more than about half a second of processor time, and those that take half a minute, one in a line.
LISTS = {length: Path(__file__).with_name(f"{length}.txt") for length in ("long", "hardest")}


def pytest_addoption(parser):
    parser.addoption("--long", action="store_true", help="run the tests of long.txt only")
    parser.addoption("--hardest", action="store_true", help="run the tests of hardest.txt and those marked hardest only")


def pytest_collection_modifyitems(config, items):
    """Keep the tests of one length, as the option --long or --hardest asks, else all that are of neither.

    Tests that are named one by one run in any case.
    """
    if any("::" in argument for argument in config.args):
        return
    listed = {name: length for length, path in LISTS.items() for name in path.read_text(encoding="utf-8").splitlines()}
    asked = next((length for length in LISTS if config.getoption(f"--{length}")), "")

    def length(item) -> str:
        return "hardest" if item.get_closest_marker("hardest") else listed.get(item.nodeid, "")

    config.hook.pytest_deselected(items=[item for item in items if length(item) != asked])
    items[:] = [item for item in items if length(item) == asked]


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    """Keep compiled functions in a folder of this run, which all its workers share: a key is a hash of what is compiled.

    No function is compiled because a test before wanted it too: the functions give the same numbers (`test_compiled.py`).
    Tests of compiled functions, commands in their own processes, and long solves compile.
    """
    base = tmp_path_factory.getbasetemp()
    run = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    patch = pytest.MonkeyPatch()
    patch.setenv("LINKPLAN_CACHE", str(run / "cache"))
    patch.setattr("linkplan.models.compiled.functions.wanted_again", lambda _folder, _key: False)
    yield
    patch.undo()


@pytest.fixture(autouse=True, scope="session")
def time_for_proofs():
    """Give the proof that comes with a plan a minute: on a slow machine it would be skipped, and a note says so."""
    patch = pytest.MonkeyPatch()
    patch.setattr("linkplan.api.plans._PROOF_SECONDS", 60.0)
    yield
    patch.undo()


@pytest.fixture(autouse=True, scope="session")
def mechanisms_loaded_once():
    """Load the mechanism of a built-in name or a text once for many problems, each of which has a copy of its own."""
    load, known = build.load_mechanism, {}

    def remembered(source, **more):
        if source not in MODELS and "<mujoco" not in source:
            return load(source, **more)
        key = repr((source, sorted(more.items())))
        if key not in known:
            known[key] = load(source, **more)
        if len(known) > MOST_MECHANISMS:
            known.pop(next(iter(known)))
        return known[key]

    patch = pytest.MonkeyPatch()
    patch.setattr(build, "load_mechanism", remembered)
    yield
    patch.undo()


@pytest.fixture(autouse=True, scope="session")
def blank_figures():
    """Save figures as empty files, without layout: drawing and layout took a fifth of the time of the commands' tests."""

    def save(figure, path, *options, **more):
        if isinstance(path, Path):
            path.touch()
        else:
            DRAW(figure, path, *options, **more)

    patch = pytest.MonkeyPatch()
    patch.setattr(Figure, "savefig", save)
    patch.setattr(figures, "_lay_out", lambda _figure: None)
    yield
    patch.undo()


@pytest.fixture
def placed_figures(monkeypatch):
    """Lay figures out without writing files, for tests that read their texts (tests/support/figure_texts.py)."""
    monkeypatch.setattr(figures, "_lay_out", LAY_OUT)


@pytest.fixture
def drawn_figures(monkeypatch, placed_figures):  # noqa: ARG001
    """Draw the figures of a test that looks at them."""
    monkeypatch.setattr(Figure, "savefig", DRAW)


@pytest.fixture
def default_signals():
    """Let SIGINT, SIGTERM and SIGHUP do in this process and its children what they do by default.

    A process inherits which signals are ignored: nohup ignores SIGHUP, a job in the background of a script SIGINT.
    """
    handlers = {"SIGINT": signal.default_int_handler, "SIGTERM": signal.SIG_DFL, "SIGHUP": signal.SIG_DFL}
    known = {getattr(signal, name): handler for name, handler in handlers.items() if hasattr(signal, name)}
    before = {number: signal.signal(number, handler) for number, handler in known.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def ask(capsys):
    """Run a command; return its exit code, its stdout and its stderr."""

    def run(*argv: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = main(list(argv))
        out, err = capsys.readouterr()
        return code, out, err

    return run


@pytest.fixture
def ask_json(ask):
    """Run a command with --json; return its exit code and the one object that it prints."""

    def run(*argv: str) -> tuple[int, dict]:
        code, out, _ = ask(*argv, "--json")
        assert out.count("\n") == 1
        return code, json.loads(out)

    return run
