"""Settings of mesh, solver and tracking: checked when they are made, by the keys that problem files have."""

import numpy as np
import pytest

from linkplan.models.compiled import functions
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.errors import ProblemError
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.problem.settings import MeshSettings, SolverSettings, Tracking
from linkplan.planner.search.planning import plan_motion

# Settings that cannot be used, what sets the same in a problem file (None where no file can say it), words of the answer.
REFUSED = [
    (SolverSettings, {"compile": "allways"}, "solver.compile=allways", ["'allways'", "did you mean 'always'", "auto"]),
    (SolverSettings, {"max_time_s": 0}, "solver.max_time_s=0", ["solver.max_time_s is a positive number", "got 0"]),
    (SolverSettings, {"starts": 0}, "solver.starts=0", ["solver.starts is a whole number from 1 to 1000", "got 0"]),
    (SolverSettings, {"max_iterations": True}, None, ["solver.max_iterations is a whole number", "got True"]),
    (Tracking, {"delay_periods": 1001}, "tracking.delay_periods=1001", ["tracking.delay_periods", "from 0 to 1000", "1001"]),
    (
        Tracking,
        {"lqr_position_deg": -5.0},
        "tracking.lqr_position_deg=-5.0",
        ["tracking.lqr_position_deg is a positive number"],
    ),
    (
        Tracking,
        {"lqr_velocity_deg_s": 1e10},
        "tracking.lqr_velocity_deg_s=1e10",
        ["tracking.lqr_velocity_deg_s", "to 1e+09"],
    ),
    (MeshSettings, {"effort": "linar"}, "mesh.effort=linar", ["mesh.effort", "did you mean 'linear'"]),
    (MeshSettings, {"intervals": 1}, "mesh.intervals=1", ["mesh.intervals is a whole number from 2 to 20000", "got 1"]),
    (
        MeshSettings,
        {"tolerance_deg": 0.1},
        "mesh.tolerance_deg=0.1",
        ["mesh.tolerance_deg is from 1e-09", "0.01", "got 0.1"],
    ),
    (MeshSettings, {"breaks": [0, 0.6, 0.4, 1]}, "mesh.breaks=[0, 0.6, 0.4, 1]", ["mesh.breaks", "[0, 0.6, 0.4, 1]"]),
    (MeshSettings, {"breaks": 3}, "mesh.breaks=3", ["mesh.breaks is three or more increasing numbers", "got 3"]),
]


@pytest.mark.parametrize(("settings", "values", "override", "words"), REFUSED, ids=lambda value: str(value)[:40])
def test_settings_that_cannot_be_used_are_refused_where_they_are_made(settings, values, override, words):
    with pytest.raises(ProblemError) as raised:
        settings(**values)
    for word in words:
        assert word in str(raised.value)
    if override is not None:
        with pytest.raises(ProblemError) as in_file:
            load_problem("knee-reach", [override])
        for word in words:
            assert word in str(in_file.value)


def test_numpys_numbers_are_numbers_and_kept_as_pythons():
    settings = Tracking(kp=np.float64(3.0), delay_periods=np.int64(2))
    solver = SolverSettings(starts=np.int64(4), max_time_s=np.float32(2.0))
    assert type(settings.kp) is float
    assert settings.tracked().delay_periods == 2
    assert type(solver.starts) is int
    assert solver.max_time_s == 2.0


def test_angles_at_the_ends_of_what_is_legal_survive_their_way_through_radians():
    for end in (1e-9, 1e9):
        problem = load_problem("knee-reach", [f"tracking.lqr_position_deg={end}"])
        assert np.degrees(problem.tracking.lqr_errors(problem.mechanism.independent_joints)[0][0]) == pytest.approx(end)


def test_a_broken_delay_is_for_loops_and_not_for_motions_that_are_tracked():
    problem = load_problem("knee-reach")
    broken = Tracking(delay_periods=0.5)
    values = {name: getattr(problem, name) for name in Problem.__slots__} | {"tracking": broken}
    with pytest.raises(ProblemError, match=r"tracking\.delay_periods is a whole number from 0 to 1000, got 0\.5"):
        Problem(**values)


def test_what_compiles_knows_when_the_plan_is_to_be_done(monkeypatch):
    known = []

    def interpreted(key, kind, build, deadline=NO_DEADLINE):
        del key, kind
        known.append(deadline)
        return build()

    monkeypatch.setattr(functions, "compiled", interpreted)
    monkeypatch.setattr(functions, "cached", lambda *_: None)
    problem = load_problem("knee-reach", ("solver.compile=always", "solver.max_time_s=60"))
    begun = Deadline().within(60.0 + 1.0)
    assert plan_motion(problem).trajectory is not None
    assert len(known) >= 2
    assert all(deadline.at_s <= begun.at_s for deadline in known)
