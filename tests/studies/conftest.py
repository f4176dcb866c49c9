"""The command line in a test's hands."""

import pytest

from linkplan.studies.cli.main import main


@pytest.fixture
def ask(capsys):
    """Run a command; return its exit code, its stdout and its stderr."""

    def run(*argv: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = main(list(argv))
        out, err = capsys.readouterr()
        return code, out, err

    return run
