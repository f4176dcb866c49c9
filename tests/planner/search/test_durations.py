"""Free durations of mechanisms: bounded where the user bounds them, said where they have no end."""

import pytest

from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.tolerances_planner import BEST_DURATION, LEAST_EFFORT, LONGEST_DURATION

ARM = """<mujoco model="arm">
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="arm"><joint name="J" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="1"/></body>
  </worldbody>
  <actuator><motor name="act" joint="J" ctrlrange="-8 8"/></actuator>
</mujoco>"""
LIFT = """<mujoco model="lift">
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="load"><joint name="Z" type="slide" axis="0 0 1"/><geom type="sphere" size="0.05" mass="2"/></body>
  </worldbody>
  <actuator><motor name="act" joint="Z" ctrlrange="-200 200"/></actuator>
</mujoco>"""
RAISE = """[mechanism]
model = "lift.xml"
[motion]
kind = "reach"
start_m = { Z = 0.0 }
goal_m = { Z = 0.3 }
duration_s = "free"
[objective]
minimize = "effort"
"""
REACH = """[mechanism]
model = "arm.xml"
[motion]
kind = "reach"
start_deg = { J = 0.0 }
goal_deg = { J = 40.0 }
duration_s = "free"
[objective]
minimize = "effort"
"""


def planned(tmp_path, *settings: str):
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    (tmp_path / "reach.toml").write_text(REACH, encoding="utf-8")
    return plan_motion(load_problem(tmp_path / "reach.toml", settings))


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["effort", "work"])
def test_a_motion_that_costs_less_the_longer_it_is_has_no_best_duration_and_says_so(objective, tmp_path):
    plan = planned(tmp_path, f"objective.minimize={objective}")
    assert plan.status == "failed"
    assert f"the objective is unbounded in the duration: the longer the motion, the smaller its {objective}" in plan.message
    assert plan.message.endswith("set motion.max_duration_s")


@pytest.mark.slow
@pytest.mark.parametrize("longest", [3.0, 30.0])
def test_a_longest_duration_is_used_to_the_full_however_long(longest, tmp_path):
    """Without gravity, effort is 12 (J angle)^2 / T^3: the last of them far beyond what a guess allows at once."""
    plan = planned(tmp_path, f"motion.max_duration_s={longest}")
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s == pytest.approx(longest, rel=LONGEST_DURATION)
    shorter = planned(tmp_path, "motion.duration_s=1.0")
    assert plan.objective == pytest.approx(shorter.objective / longest**3, rel=LONGEST_DURATION)


def test_weight_gives_a_motion_a_best_duration(tmp_path):
    """A mass m lifted by d under gravity costs m^2 (g^2 T + 12 d^2 / T^3): least at T^4 = 36 d^2 / g^2."""
    (tmp_path / "lift.xml").write_text(LIFT, encoding="utf-8")
    (tmp_path / "lift.toml").write_text(RAISE, encoding="utf-8")
    plan = plan_motion(load_problem(tmp_path / "lift.toml"))
    assert plan.status == "optimal", plan.message
    T = (36 * 0.3**2 / 9.81**2) ** 0.25
    assert plan.trajectory.duration_s == pytest.approx(T, rel=BEST_DURATION)
    assert plan.objective == pytest.approx(2.0**2 * 9.81**2 * T * 4 / 3, rel=LEAST_EFFORT)
