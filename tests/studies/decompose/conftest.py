"""The command line in a test's hands, as the tests of the command line have it."""

from tests.studies.cli.conftest import ask, ask_json

__all__ = ["ask", "ask_json"]
