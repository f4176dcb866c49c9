"""Saved objectives of motions that need nothing: what the solver's rounding leaves of them is no reason to refuse a plan."""

from dataclasses import replace

import pytest

from linkplan.models.errors import CertificateError
from linkplan.planner.certificate.further_checks import negligible_objective
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion

ARM = """
<mujoco model="arm">
  <option gravity="0 0 {gravity}"/>
  <worldbody>
    <body><joint name="A" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/></body>
  </worldbody>
  <actuator><motor name="m" joint="A" {range}/></actuator>
</mujoco>
"""
LIMITED, UNLIMITED = 'ctrlrange="-5 5" ctrllimited="true"', ""
# gravity [m/s2], start and goal [deg], duration [s]
MOTIONS = {
    "without weight": (0.0, 0, 0, 0.5),
    "in balance": (-9.81, 0, 0, 20.0),
    "that its weight makes": (-9.81, -10, 10, 0.4485),
}


def planned(tmp_path, motion: str, range_: str, minimize):
    gravity, start, goal, duration = MOTIONS[motion]
    (tmp_path / "arm.xml").write_text(ARM.format(gravity=gravity, range=range_))
    ends = {"start_deg": {"A": start}, "goal_deg": {"A": goal}}
    tables = {
        "mechanism": {"model": str(tmp_path / "arm.xml")},
        "motion": {"kind": "reach", "duration_s": duration} | ends,
        "objective": {"minimize": minimize},
    }
    return plan_motion(Problem.from_tables("arm", tables))


@pytest.mark.parametrize("minimize", ["work", "effort", {"work": 1e-3, "effort_rate": 1e-6}], ids=str)
@pytest.mark.parametrize("range_", [LIMITED, UNLIMITED], ids=["limited", "unlimited"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_plan_that_needs_next_to_nothing_is_read_as_it_was_saved(motion, range_, minimize, tmp_path):
    plan = planned(tmp_path, motion, range_, minimize)
    assert plan.passed, plan.message
    (tmp_path / "plan").mkdir()
    write_plan(plan, tmp_path / "plan")
    again = read_plan(tmp_path / "plan")
    assert (again.status, again.objective) == (plan.status, plan.objective)


def test_an_objective_beyond_what_counts_as_none_is_refused_of_a_motion_that_needs_none(tmp_path):
    plan = planned(tmp_path, "without weight", LIMITED, "work")
    floor = negligible_objective(plan.problem, plan.trajectory)
    assert floor == pytest.approx(1e-6 * 5)  # a millionth of 5 N.m through a radian [J]
    with pytest.raises(CertificateError, match="saved objective is"):
        write_plan(replace(plan, objective=3 * floor), tmp_path)
