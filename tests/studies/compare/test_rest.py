"""Held poses in unstable equilibria, from which no disturbance moves a machine."""

import pytest

import linkplan

# A rod that stands on its hinge: its weight needs 1.5 N.m/rad or more.
ROD = """<mujoco><worldbody><body name="rod"><joint name="J" axis="0 1 0" damping="0.01"/><inertial pos="0 0 -0.3" mass="0.5"
diaginertia="1e-3 1e-3 1e-3"/></body></worldbody><actuator><motor name="m" joint="J" ctrlrange="-20 20"/></actuator>
</mujoco>"""


@pytest.mark.parametrize(("start_deg", "kp", "is_stable"), [(180.0, 0.7, False), (180.0, 5.0, True), (0.0, 0.7, True)])
def test_a_held_pose_is_stable_if_a_machine_beside_it_returns(start_deg, kp, is_stable):
    problem = linkplan.Problem.hold(ROD, start_deg={"J": start_deg}, duration_s=0.5, tracking={"kp": kp, "kd": 0.3})
    result = linkplan.compare(problem, trackers=["pd", "pd+ff", "lqr"], mass_factor=1.0, delay_periods=0)
    stable = {name: run.stable for name, run in result.comparison.nominal.items()}
    assert stable == {"pd": is_stable, "pd+ff": is_stable, "lqr": True}
    assert ("moves away from it, under pd, pd+ff" in str(result)) is not is_stable
    assert linkplan.track(problem, tracker="pd").passed is is_stable
