"""The command line's --json in a test's hands."""

import json

import pytest


@pytest.fixture
def ask_json(ask):
    """Run a command with --json; return its exit code and the one object that it prints."""

    def run(*argv: str) -> tuple[int, dict]:
        code, out, _ = ask(*argv, "--json")
        assert out.count("\n") == 1
        return code, json.loads(out)

    return run
