"""A saved plan in a test's hands."""

import pytest

from tests.support.plans import saved_plan


@pytest.fixture
def saved_reach(tmp_path):
    """Return a folder that holds the plan of knee-reach."""
    return saved_plan("knee-reach", tmp_path)
