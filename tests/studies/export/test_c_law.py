"""A plan's law in C against the trackers: the same efforts, and the same run in MuJoCo."""

import ctypes
import functools
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.models.actuation.distribution import distribute
from linkplan.models.errors import ProblemError
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker, track, tracking_reference
from linkplan.studies.handover.export.c_law import write_law
from linkplan.studies.handover.export.law_tables import LawTables, law_tables
from tests.support.compiled import library, needs_gcc
from tests.support.plans import optimal
from tests.support.redundant import hung_point

# The law's sum in another order than the tracker's, relative to the largest effort. Measured 2e-16.
LAW_ROUNDING = 1e-12
TRACKERS = ["pd", "pd+ff", "lqr", "gs-pd+ff"]


@functools.cache
def written(problem: str, tracker: str, *changed: str) -> tuple[LawTables, Path, dict]:
    tables = law_tables(optimal(problem, *changed), tracker)
    folder = Path(tempfile.mkdtemp())
    return tables, folder, write_law(tables, folder, "a plan", compiled=False)


def efforts_in_c(tables: LawTables, folder: Path, t: np.ndarray, s: np.ndarray, v: np.ndarray, *, single: bool = False):
    """Return the efforts (n, n_u) of the compiled law at times t [s], and its statuses (n,)."""
    function, real = (
        getattr(library(folder, tables.prefix, single=single), tables.prefix),
        ctypes.c_float if single else ctypes.c_double,
    )
    dtype = np.float32 if single else np.float64
    found, status = np.empty((len(t), tables.gains.shape[1]), dtype=dtype), []
    function.argtypes = [real, *[ctypes.c_void_p] * 3]
    for i in range(len(t)):
        state = [np.ascontiguousarray(x[i], dtype=dtype) for x in (s, v)]
        status.append(function(t[i], *[x.ctypes.data for x in state], found[i].ctypes.data))
    return found, np.array(status)


def efforts_near(plan: Plan, tracker: str, n: int):
    """Return a reference, instants (n,) and states (n, n_s) near it, and the tracker's efforts (n, n_u) there."""
    reference, random = tracking_reference(plan), np.random.default_rng(4)
    k = random.integers(0, reference.n, n)
    s = reference.position_rad[k] + 0.02 * random.normal(size=reference.position_rad[k].shape)
    v = reference.velocity_rad_s[k] + 0.5 * random.normal(size=s.shape)
    built = build_tracker(tracker, plan, reference)
    return reference, k, s, v, np.array([built.effort(int(i), *state) for i, *state in zip(k, s, v, strict=True)])


@needs_gcc
@pytest.mark.parametrize(
    ("problem", "tracker"),
    [
        *(("knee-reach", tracker) for tracker in TRACKERS),
        *(pytest.param("five-bar-reach", tracker, marks=pytest.mark.slow) for tracker in ("pd+ff", "lqr")),
    ],
)
def test_the_law_in_c_is_the_tracker_s(problem, tracker):
    tables, folder, _ = written(problem, tracker)
    reference, k, s, v, wanted = efforts_near(optimal(problem), tracker, 500)
    t = k * reference.period_s
    size = np.abs(wanted).max()
    assert size > 1
    assert np.abs(efforts_in_c(tables, folder, t, s, v)[0] - wanted).max() < LAW_ROUNDING * size
    assert np.abs(efforts_in_c(tables, folder, t, s, v, single=True)[0] - wanted).max() < 1e-4 * size


class InC:
    """The compiled law as a tracker of one's own."""

    name = "in C"

    def __init__(self, tables: LawTables, folder: Path) -> None:
        self.function, self.tables = getattr(library(folder, tables.prefix), tables.prefix), tables
        self.function.argtypes = [ctypes.c_double, *[ctypes.c_void_p] * 3]

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        state = [np.ascontiguousarray(x, dtype=float) for x in (position, velocity)]
        found = np.empty(self.tables.gains.shape[1])
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


def held_effort(plan: Plan, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the position at a time, and the effort that holds it in MuJoCo without speed and acceleration."""
    mechanism, position = plan.problem.mechanism, plan.trajectory.position_at(np.array([time_s]))
    q = follow(mechanism, position, plan.trajectory.start_pose)
    return position[0], needed_effort(mechanism, q, np.zeros_like(position), np.zeros_like(position))[0][0]


@needs_gcc
@pytest.mark.parametrize("tracker", ["pd+ff", "lqr"])
@pytest.mark.parametrize("changed", [[], ["tracking.period_s=0.0007"], ["tracking.duration_s=0.05"]])
def test_before_the_motion_the_law_in_c_holds_the_start_and_after_it_the_goal(tracker, changed):
    tables, folder, _ = written("knee-reach", tracker, *changed)
    plan = optimal("knee-reach", *changed)
    duration = plan.trajectory.duration_s
    for single in (False, True):
        for at, times in ((0.0, [-10.0, -1e-3, -1e-6 - 1e-3]), (duration, [duration + 1e-6, duration + 1e-3, 10.0, np.inf])):
            position, effort = held_effort(plan, at)
            assert 1 < abs(effort[0]) < 10
            s = np.tile(position, (len(times), 1))
            found, status = efforts_in_c(tables, folder, np.array(times), s, np.zeros_like(s), single=single)
            assert not np.any(status)
            assert np.abs(found - effort).max() < (1e-3 if single else 1e-9)


@needs_gcc
@pytest.mark.slow
def test_the_law_in_c_holds_the_knee_at_the_goal_in_mujoco():
    tables, folder, _ = written("knee-reach", "lqr")
    run = track(optimal("knee-reach", "tracking.duration_s=2.0"), InC(tables, folder))
    assert run.stable
    rest = run.error_rad[int(1.0 / tables.period_s) :]
    assert len(rest) > 5000
    assert np.degrees(np.abs(rest).max()) < 0.05


@needs_gcc
@pytest.mark.parametrize("tracker", ["pd+ff", "lqr"])
def test_the_law_in_c_repeats_a_periodic_motion_from_the_rows_of_one_period(tracker):
    tables, folder, record = written("knee-sine", tracker)
    reference, k, s, v, wanted = efforts_near(optimal("knee-sine"), tracker, 300)
    assert (reference.n, record.instants, reference.cycle) == (20_000, 2501, 2500)
    later = k * reference.period_s + 40 * 0.25
    for t in (k * reference.period_s, later, later - 80 * 0.25):
        assert np.abs(efforts_in_c(tables, folder, t, s, v)[0] - wanted).max() < 1e-9 * np.abs(wanted).max()


@needs_gcc
@pytest.mark.parametrize("period_s", [1e-3, 0.7e-3])
def test_a_crank_that_turns_on_is_a_turn_further_in_each_period(period_s, tmp_path):
    tracking = {"period_s": period_s, "duration_s": 1.6, "kp": 1.0, "kd": 0.1}
    plan = plan_motion(Problem.periodic("slider-crank", turns={"O": 1}, duration_s=0.5, tracking=tracking))
    tables = law_tables(plan, "pd+ff")
    write_law(tables, tmp_path, "a plan", compiled=False)
    reference, k, s, v, wanted = efforts_near(plan, "pd+ff", 300)
    assert np.ptp(s) > 6 * np.pi
    # a control period that does not divide the motion's puts the rows beside the control instants
    near = 1e-9 if reference.cycle is not None else 1e-3
    assert np.abs(efforts_in_c(tables, tmp_path, k * period_s, s, v)[0] - wanted).max() < near * np.abs(wanted).max()


@needs_gcc
def test_what_is_not_finite_is_told_and_leaves_the_feedforward():
    tables, folder, _ = written("knee-reach", "pd+ff")
    t, goal = np.array([0.05] * 4 + [np.nan]), tables.position[-1]
    s, v = np.tile(tables.position[0], (5, 1)), np.zeros((5, 1))
    s[0], s[1], v[2], v[3] = np.nan, np.inf, np.nan, -np.inf
    found, status = efforts_in_c(tables, folder, t, s, v)
    assert np.all(status == 1)
    assert np.all(np.isfinite(found))
    reference = tracking_reference(optimal("knee-reach"))
    np.testing.assert_allclose(found[:4, 0], reference.effort[500, 0], rtol=1e-9)
    found, status = efforts_in_c(tables, folder, np.array([1.0]), goal[None], np.zeros((1, 1)))
    assert status[0] == 0


@needs_gcc
def test_efforts_are_limited_on_request_only():
    tables, folder, _ = written("knee-reach", "pd+ff")
    limited = getattr(library(folder, tables.prefix), f"{tables.prefix}_limited")
    for effort, status, cut in ((1e6, 0, 100.0), (-np.inf, 0, -100.0), (7.0, 0, 7.0), (np.nan, 1, 0.0)):
        given = np.array([effort])
        assert limited(ctypes.c_void_p(given.ctypes.data)) == status
        assert given[0] == cut
    far, _ = efforts_in_c(tables, folder, np.array([3e-4]), np.full((1, 1), -50.0), np.zeros((1, 1)))
    assert far[0, 0] > tables.limits.effort[0, 1]


@needs_gcc
@pytest.mark.parametrize(("problem", "tracker"), [("knee-reach", "lqr"), ("knee-sine", "pd+ff")])
def test_a_tolerance_leaves_out_rows_and_keeps_the_efforts_within_it(problem, tracker):
    plan, tolerance = optimal(problem), 1e-3
    tables, folder = law_tables(plan, tracker, tolerance), Path(tempfile.mkdtemp())
    record = write_law(tables, folder, "a plan", compiled=False)
    reference = tracking_reference(plan)
    assert record.instants < 0.2 * min(reference.n, 2500)
    k = np.arange(0, reference.n, 3)
    s, v = reference.position_rad[k], reference.velocity_rad_s[k]
    found, _ = efforts_in_c(tables, folder, k * reference.period_s, s, v)
    off = np.abs(found - reference.effort[k]).max() / np.abs(reference.effort).max()
    assert 1e-6 < off <= 1.001 * tolerance


def test_a_tolerance_is_a_share_below_one(capsys, tmp_path):
    words = ["export", "knee-reach", "--to", "c", "--tolerance", "1.5", "-o", str(tmp_path / "law")]
    assert main(words) == 2
    assert "a share from 0 to below 1, got 1.5" in capsys.readouterr().err


def test_the_header_has_the_limits_and_the_hashes_of_model_and_plan():
    tables, folder, record = written("knee-reach", "pd+ff")
    text = (folder / f"{tables.prefix}.h").read_text()
    upper = tables.prefix.upper()
    for macro, value in (("U0_MIN", -100.0), ("U0_MAX", 100.0), ("V0_MAX", 1e30), ("Q0_MIN", tables.limits.position[0, 0])):
        (found,) = re.findall(rf"#define {upper}_{macro} \((.*)\)", text)
        assert float(found) == value
    other = law_tables(optimal("knee-reach", "motion.duration_s=0.17"), "pd+ff")
    assert other.plan_hash != tables.plan_hash
    for key, value in (("MODEL_HASH", record.model_hash), ("PLAN_HASH", tables.plan_hash)):
        assert f'#define {upper}_{key} "{value}"' in text


def test_a_tracker_that_is_no_table_is_refused(tmp_path):
    with pytest.raises(ProblemError, match="tracker for C 'ct'"):
        linkplan.export(optimal("knee-reach"), tmp_path / "law", to="c", tracker="ct")


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


@needs_gcc
def test_more_motors_than_freedoms_share_their_efforts_within_limits_in_c():
    """The law in C changes efforts beyond the limits as the simulated drives do."""
    table = {"time_s": [0.0, 0.3, 0.6], "position_m": {"x": [-0.2, 0.0, 0.2], "z": [0.0, 0.1, 0.0]}}
    plan = plan_motion(Problem.track(linkplan.load_mechanism(hung_point()), reference=table))
    tables, folder = law_tables(plan, "pd+ff"), Path(tempfile.mkdtemp())
    write_law(tables, folder, "a plan", compiled=False)
    limited = getattr(library(folder, tables.prefix), f"{tables.prefix}_limited")
    limited.argtypes = [ctypes.c_double, ctypes.c_void_p]
    random, limit = np.random.default_rng(5), plan.problem.mechanism.effort_limit
    beyond, off, lacking = 0, [], []
    for k in random.integers(0, len(tables.time_s), 300):
        arms = tables.maps[tables.held + k].T
        command = random.uniform(*limit.T) + (np.eye(4) - np.linalg.pinv(arms) @ arms) @ random.normal(0, 60, 4)
        (wanted,) = distribute((arms @ command)[None], arms[None], limit, command)
        effort = command.copy()
        assert limited(tables.time_s[k], effort.ctypes.data) == 0
        assert np.all((effort >= limit[:, 0]) & (effort <= limit[:, 1]))
        off.append(np.abs(effort - wanted).max())
        lacking.append(np.abs(arms @ (effort - command)).max())
        beyond += bool(np.any((command < limit[:, 0]) | (command > limit[:, 1])))
    assert beyond > 150
    assert np.quantile(off, 0.9) < 1e-5
    assert max(lacking) < 0.03 * limit.max()  # slow where a single motor is left between its limits
    effort[:] = [np.nan, 1e9, -1e9, np.inf]
    assert limited(0.0, effort.ctypes.data) == 1
    assert effort.tolist() == [5.0, 100.0, 5.0, 100.0]
