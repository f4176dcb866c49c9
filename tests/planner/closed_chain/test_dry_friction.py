"""Motions planned with dry friction: against closed forms, MuJoCo, and the same without it."""

import numpy as np
import pytest

from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import track
from tests.support.bodies import RUBBED_ARM

# The arm's: (2 - 0.5) / 0.1 and (2 + 0.5) / 0.1 rad/s2.
INERTIA, RUB, EFFORT, SPAN = 0.1, 0.5, 2.0, np.pi / 2
ENDS = {"start_deg": {"J": 0.0}, "goal_deg": {"J": 90.0}}
# What friction that turns over at 2 deg/s takes less than Coulomb's, relative: of a least time, and of a least effort.
# In proportion to it: measured 1.2e-3 and 1.0e-2 at 5.7 deg/s, a tenth of each at 0.57 deg/s.
EARLY, CHEAP = 6e-4, 6e-3
# A plan's feedforward with PD in MuJoCo, whose friction is as the model's [deg]. Measured 0.002 to 0.01.
TRACKED_DEG = 0.05


def planned(duration: float | str, minimize: str, ends: dict = ENDS, **mechanism: object) -> Plan:
    tables = {
        "mechanism": {"model": RUBBED_ARM, "solref": "stiff"} | mechanism,
        "motion": {"kind": "reach", "duration_s": duration} | ends,
        "objective": {"minimize": minimize},
        "tracking": {"kp": 20.0, "kd": 2.0, "period_s": 1e-3},
    }
    return plan_motion(Problem.from_tables("rubbed arm", tables))


def test_the_least_time_is_that_of_full_effort_against_friction_and_of_braking_with_it():
    exact = np.sqrt(2 * SPAN * INERTIA * (1 / (EFFORT - RUB) + 1 / (EFFORT + RUB)))
    without = np.sqrt(4 * SPAN * INERTIA / EFFORT)
    plan = planned("free", "time").require()
    assert abs(without / exact - 1) > 10 * EARLY, "friction counts"
    assert -EARLY < plan.objective / exact - 1 < 0, "a little early: it breaks loose gradually"


@pytest.mark.slow
def test_the_least_time_of_several_freedoms_that_rub_is_found():
    """Two such arms, turned as far: each alone takes as long as both."""
    body = RUBBED_ARM[RUBBED_ARM.index("<body>") : RUBBED_ARM.index("</body>") + 7]
    motor = '<motor name="m" joint="J" ctrlrange="-2 2"/>'
    both = RUBBED_ARM.replace(body, body + body.replace('"J"', '"K"'))
    both = both.replace(motor, motor + motor.replace('"J"', '"K"').replace('"m"', '"n"'))
    ends = {"start_deg": {"J": 0.0, "K": 0.0}, "goal_deg": {"J": 90.0, "K": 90.0}}
    exact = np.sqrt(2 * SPAN * INERTIA * (1 / (EFFORT - RUB) + 1 / (EFFORT + RUB)))
    plan = planned("free", "time", ends, model=both)
    assert plan.problem.mechanism.dof == 2
    assert -EARLY < plan.require().objective / exact - 1 < EARLY


def test_the_least_effort_carries_friction_all_the_way():
    exact = 12 * INERTIA**2 * SPAN**2 + RUB**2  # the cubic's, and u = f + M a in place of M a, in a second
    plan = planned(1.0, "effort").require()
    assert -CHEAP < plan.objective / exact - 1 < 0


def test_its_feedforward_is_followed_in_mujoco_with_the_models_own_friction():
    plan = planned(1.0, "effort").require()
    assert plan.problem.mechanism.model.dof_frictionloss[0] == RUB, "the simulated machine rubs"
    rollout = track(plan, "pd+ff")
    assert np.degrees(np.abs(rollout.error_rad).max()) < TRACKED_DEG
    assert np.degrees(np.abs(track(plan, "pd").error_rad).max()) > 10 * TRACKED_DEG, "feedback alone leaves it behind"


def test_a_motor_that_cannot_overcome_friction_is_told_so():
    weak = RUBBED_ARM.replace('ctrlrange="-2 2"', 'ctrlrange="-0.4 0.4"')
    plan = plan_motion(Problem.reach(weak, **ENDS, duration_s=1.0))
    assert not plan.passed
    assert "m on joint J" in plan.message


def test_a_motion_too_slow_for_its_friction_says_so():
    fast, slow = planned(1.0, "effort"), planned(1.0, "effort", friction_transition_deg_s=60.0)
    assert "dry friction" not in fast.message
    assert "joint J moves slowly for" in slow.message
    assert slow.details["slow_friction_share"] > 0.3


@pytest.mark.slow
def test_a_swing_up_turns_back_against_friction():
    model = """<mujoco><worldbody><body><joint name="J" axis="0 1 0" frictionloss="0.1"/>
      <geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.5" mass="1"/></body></worldbody>
      <actuator><motor name="m" joint="J" ctrlrange="-1 1"/></actuator></mujoco>"""

    def least_time(text: str) -> Plan:
        return plan_motion(Problem.reach(text, start_deg={"J": 0.0}, goal_deg={"J": 180.0}, minimize="time")).require()

    rubbed, smooth = least_time(model), least_time(model.replace(' frictionloss="0.1"', ""))
    assert rubbed.trajectory.velocity.min() < -1.0, "it swings back first"
    # 1.80609 s without; 1.90353 s with friction that turns over at 0.5 deg/s, 1.90344 s at 3 deg/s.
    assert abs(smooth.objective - 1.80609) < 1e-4
    assert abs(rubbed.objective - 1.9035) < 2e-4
