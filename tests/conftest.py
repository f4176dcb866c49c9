"""What every test has: a cache of compiled functions of its own, so that nothing found on the machine decides a test."""

import pytest


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    """Keep compiled functions in a folder of this run."""
    patch = pytest.MonkeyPatch()
    patch.setenv("LINKPLAN_CACHE", str(tmp_path_factory.mktemp("cache")))
    yield
    patch.undo()
