"""The least peak effort, against bang-bang motions of masses and against least times under the peak as a limit."""

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.replan import structure
from tests.support.plans import problem_of

GANTRY = """<mujoco><option gravity="0 0 0"/>
  <worldbody>
    <body><joint name="X" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="3"/>
      <body pos="0 0 .3"><joint name="Y" type="slide" axis="0 1 0"/><geom type="box" size=".1 .1 .1" mass="2"/></body>
    </body>
  </worldbody>
  <actuator><motor name="F" joint="X" ctrlrange="-100 100"/><motor name="G" joint="Y" ctrlrange="-40 40"/></actuator>
</mujoco>"""


def gantry(minimize: str | dict[str, float], duration_s: float | str, y_m: float) -> Problem:
    """Return the problem of 5 kg on X and 2 kg on Y, moved by 1 m and `y_m` from rest to rest."""
    return Problem.reach(
        load_mechanism(GANTRY),
        start_m={"X": 0.0, "Y": 0.0},
        goal_m={"X": 1.0, "Y": y_m},
        duration_s=duration_s,
        minimize=minimize,
    )


@pytest.mark.parametrize(("y_m", "share"), [(0.1, 0.2), (2.0, 0.4)])  # decided by X, by Y
def test_the_least_peak_of_two_motors_is_the_larger_share_of_bang_bang_forces(y_m, share):
    """4 m d / T^2 is 20 N on X in 1 s; on Y it is 0.8 N or 16 N."""
    plan = plan_motion(gantry("peak_effort", 1.0, y_m))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(share, rel=2e-5)
    effort = np.abs(plan.trajectory.effort_at(plan.trajectory.dense_times(20))).max(axis=0)
    assert (effort / [100.0, 40.0]).max() == pytest.approx(plan.objective, rel=1e-6)


def test_time_and_peak_together_have_the_closed_form_s_compromise():
    """T = 2 sqrt(m d / F) with F = 100 k; T + k is least at k = 0.05^(1/3)."""
    plan = plan_motion(gantry({"time": 1.0, "peak_effort": 1.0}, "free", 0.1))
    k = 0.05 ** (1 / 3)
    assert plan.objective == pytest.approx(2 * np.sqrt(0.05 / k) + k, rel=2e-5)
    assert plan.trajectory.duration_s == pytest.approx(2 * np.sqrt(0.05 / k), rel=1e-3)


def test_the_least_peak_in_the_least_time_of_a_limit_is_that_limit():
    """The phase plane integrates the least time under 60 of 100 N.m: another way to the same motion."""
    quick = plan_motion(problem_of("knee-sprint", "limits.effort.act_O=[-60.0, 60.0]"))
    duration = f"motion.duration_s={quick.objective!r}"
    plan = plan_motion(problem_of("knee-sprint", "objective.minimize=peak_effort", duration))
    assert plan.objective == pytest.approx(0.6, rel=1e-5)
    assert plan.certificate.passed


def test_programs_with_other_limits_are_not_used_again_for_a_peak():
    peak = problem_of("knee-reach", "objective.minimize=peak_effort")
    lower = problem_of("knee-reach", "objective.minimize=peak_effort", "limits.effort.act_O=[-90.0, 90.0]")
    assert structure(peak) != structure(lower)
    effort = problem_of("knee-reach", "limits.effort.act_O=[-90.0, 90.0]")
    assert structure(problem_of("knee-reach")) == structure(effort)


def test_a_peak_without_limits_is_refused():
    free = GANTRY.replace(' ctrlrange="-40 40"', "")
    with pytest.raises(ProblemError, match=r"'peak_effort' needs finite limits.effort \(.*missing for G\)"):
        Problem.reach(
            load_mechanism(free), goal_m={"X": 1.0, "Y": 0.0}, start_m={"X": 0.0, "Y": 0.0}, minimize="peak_effort"
        )
