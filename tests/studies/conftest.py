"""The command line in a test's hands."""

import json

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


@pytest.fixture
def ask_json(ask):
    """Run a command with --json; return its exit code and the one object that it prints."""

    def run(*argv: str) -> tuple[int, dict]:
        code, out, _ = ask(*argv, "--json")
        assert out.count("\n") == 1
        return code, json.loads(out)

    return run
