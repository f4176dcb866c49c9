"""A plan's law in C against the trackers: the same efforts, and the same run in MuJoCo."""

import ctypes
import functools
import tempfile
from pathlib import Path

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.studies.cli.main import main
from linkplan.studies.compare.compare import build_tracker, track, tracking_reference
from linkplan.studies.export.c_law import LawTables, law_tables, write_law
from tests.support.compiled import library, needs_gcc
from tests.support.plans import optimal

# The law's sum in another order than the tracker's, relative to the largest effort. Measured 2e-16.
LAW_ROUNDING = 1e-12
TRACKERS = ["pd", "pd+ff", "lqr", "gs-pd+ff"]


@functools.cache
def written(problem: str, tracker: str) -> tuple[LawTables, Path, dict]:
    tables = law_tables(optimal(problem), tracker)
    folder = Path(tempfile.mkdtemp())
    return tables, folder, write_law(tables, folder, compiled=False)


def efforts_in_c(tables: LawTables, folder: Path, k: np.ndarray, s: np.ndarray, v: np.ndarray, *, single: bool = False):
    """Return the efforts (n, n_u) of the compiled law at instants k."""
    function, real = (
        getattr(library(folder, tables.prefix, single=single), tables.prefix),
        ctypes.c_float if single else ctypes.c_double,
    )
    dtype = np.float32 if single else np.float64
    found = np.empty((len(k), len(tables.limit)), dtype=dtype)
    function.restype, function.argtypes = None, [real, *[ctypes.c_void_p] * 3]
    for i in range(len(k)):
        state = [np.ascontiguousarray(x[i], dtype=dtype) for x in (s, v)]
        function(k[i] * tables.period_s, *[x.ctypes.data for x in state], found[i].ctypes.data)
    return found


def states_near(tables: LawTables, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(4)
    k = random.integers(0, len(tables.position), n)
    s = tables.position[k] + 0.02 * random.normal(size=tables.position[k].shape)
    return k, s, tables.velocity[k] + 0.5 * random.normal(size=s.shape)


@needs_gcc
@pytest.mark.parametrize("tracker", TRACKERS)
@pytest.mark.parametrize("problem", ["knee-reach", pytest.param("five-bar-reach", marks=pytest.mark.slow)])
def test_the_law_in_c_is_the_tracker_s(problem, tracker):
    tables, folder, _ = written(problem, tracker)
    plan = optimal(problem)
    built = build_tracker(tracker, plan, tracking_reference(plan))
    k, s, v = states_near(tables, 500)
    wanted = np.array([built.effort(int(i), *state) for i, *state in zip(k, s, v, strict=True)])
    size = np.abs(wanted).max()
    assert size > 1
    assert np.abs(efforts_in_c(tables, folder, k, s, v) - wanted).max() < LAW_ROUNDING * size
    assert np.abs(efforts_in_c(tables, folder, k, s, v, single=True) - wanted).max() < 1e-4 * size


class InC:
    """The compiled law as a tracker of one's own."""

    name = "in C"

    def __init__(self, tables: LawTables, folder: Path) -> None:
        self.function, self.tables = getattr(library(folder, tables.prefix), tables.prefix), tables
        self.function.restype, self.function.argtypes = None, [ctypes.c_double, *[ctypes.c_void_p] * 3]

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        state = [np.ascontiguousarray(x, dtype=float) for x in (position, velocity)]
        found = np.empty(len(self.tables.limit))
        self.function(k * self.tables.period_s, *[x.ctypes.data for x in state], found.ctypes.data)
        return found


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize("tracker", ["pd+ff", "lqr"])
def test_a_loop_around_the_law_in_c_gives_the_log_of_the_tracker(tracker):
    tables, folder, _ = written("knee-reach", tracker)
    plan = optimal("knee-reach")
    ours, theirs = track(plan, tracker), track(plan, InC(tables, folder))
    assert np.ptp(ours.applied) > 10
    assert np.abs(theirs.applied - ours.applied).max() < 1e-8
    assert np.abs(theirs.pose_rad - ours.pose_rad).max() < 1e-11


@needs_gcc
def test_before_and_after_the_motion_the_first_and_last_instant_count():
    tables, folder, _ = written("knee-reach", "pd")
    n = len(tables.position)
    k = np.array([-500.0, -0.4, 0.4, n - 1.4, n + 1000.0])
    s, v = np.zeros((5, 1)), np.zeros((5, 1))
    wanted = [tables.effort(i, np.zeros(1), np.zeros(1)) for i in (0, 0, 0, n - 1, n - 1)]
    np.testing.assert_allclose(efforts_in_c(tables, folder, k, s, v), wanted, rtol=1e-12)


@needs_gcc
def test_efforts_are_limited_on_request_only():
    tables, folder, _ = written("knee-reach", "pd+ff")
    limited = getattr(library(folder, tables.prefix), f"{tables.prefix}_limited")
    effort = np.array([1e6])
    limited(ctypes.c_void_p(effort.ctypes.data))
    assert effort[0] == tables.limit[0, 1]
    far = efforts_in_c(tables, folder, np.array([3]), np.full((1, 1), -50.0), np.zeros((1, 1)))
    assert far[0, 0] > tables.limit[0, 1]


def test_constant_gains_are_one_row_and_others_one_for_each_instant():
    assert [len(written("knee-reach", name)[0].gains) for name in ("pd+ff", "lqr")] == [1, 1600]


def test_the_record_counts_what_is_stored():
    tables, _, record = written("knee-reach", "lqr")
    assert record["table_numbers"] == 1600 * (1 + 1 + 1 + 2)
    assert record["instants"] == len(tables.position) == 1600


def test_a_tracker_that_is_no_table_is_refused():
    with pytest.raises(ProblemError, match="tracker for C 'ct'"):
        law_tables(optimal("knee-reach"), "ct")


@pytest.mark.slow
def test_the_command_writes_the_law_of_a_saved_plan(saved_reach, tmp_path, capsys):
    folder = tmp_path / "law"
    assert main(["export", str(saved_reach), "--to", "c", "--tracker", "lqr", "--json", "-o", str(folder)]) == 0
    assert '"tracker": "lqr"' in capsys.readouterr().out
    assert "effort[0] act_O [N.m], limits" in next(folder.glob("*_law.h")).read_text()


def test_a_plan_without_a_motion_has_no_law(tmp_path, capsys):
    words = ["export", "knee-reach", "--set", "motion.duration_s=0.01", "--to", "c", "-o", str(tmp_path / "law")]
    assert main(words) == 1
    assert "infeasible" in capsys.readouterr().out
    assert not (tmp_path / "law").exists()
