"""The command line and a saved plan in a test's hands."""

import pytest

from linkplan.studies.cli.main import main
from tests.support.plans import saved_plan


@pytest.fixture
def saved_reach(tmp_path):
    """Return a folder that holds the plan of knee-reach."""
    return saved_plan("knee-reach", tmp_path)


@pytest.fixture
def ask(capsys):
    """Run a command; return its exit code, its stdout and its stderr."""

    def run(*argv: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = main(list(argv))
        out, err = capsys.readouterr()
        return code, out, err

    return run
