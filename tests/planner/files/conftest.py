"""A saved plan in a test's hands."""

from pathlib import Path

import pytest

from tests.support.plans import saved_plan


@pytest.fixture
def saved(tmp_path) -> Path:
    """Return a folder that holds the plan of knee-reach."""
    return saved_plan("knee-reach", tmp_path)
