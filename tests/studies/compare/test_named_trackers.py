"""Trackers by name: built-in, installed, and a module's own."""

import pytest

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import ProblemError
from linkplan.studies.compare.compare import compare
from linkplan.studies.compare.user_tracker import tracker_named, trackers_named, users_tracker
from tests.support.plans import optimal

LAW = """
import numpy as np


class Still:
    name = "still"

    def __init__(self, reference):
        self.reference = reference

    def effort(self, k, position, velocity):
        return self.reference.effort[k]
"""


@pytest.fixture
def laws(tmp_path, monkeypatch):
    (tmp_path / "laws_of_mine.py").write_text(LAW)
    (tmp_path / "broken_laws.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("laws")
def test_a_module_s_own_tracker_runs_beside_the_built_in_ones():
    found = compare(optimal("knee-reach"), None, asked=trackers_named("pd, laws_of_mine:Still"))
    assert list(found.nominal) == ["pd", "still"]


def test_all_are_the_built_in_ones():
    assert trackers_named("all") == list(TRACKERS)


@pytest.mark.usefixtures("laws")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lqrr", "lqr"),
        ("no_module_of_this_name:Law", "No module named"),
        ("laws_of_mine:Sill", "has no attribute 'Sill'"),
        ("broken_laws:Law", "ZeroDivisionError"),
        (",", "names with commas"),
    ],
)
def test_a_tracker_that_cannot_be_had_is_refused_in_one_line(text, said):
    with pytest.raises(ProblemError, match=said) as refused:
        trackers_named(text)
    assert "\n" not in str(refused.value)


def test_a_tracker_of_an_installed_package_is_found_by_its_name(monkeypatch, tmp_path):
    """What a distribution says in its metadata is enough."""
    (tmp_path / "laws_installed.py").write_text(LAW)
    info = tmp_path / "laws-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: laws\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[linkplan.trackers]\nstill = laws_installed:Still\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert tracker_named("still").__name__ == "Still"


@pytest.mark.parametrize("asked", [lambda: None, int])
def test_a_function_that_cannot_take_a_reference_is_refused_with_what_it_raised(asked):
    with pytest.raises(ProblemError, match="cannot be made: TypeError"):
        users_tracker(asked, None, object())
