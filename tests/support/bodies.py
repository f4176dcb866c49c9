"""Single bodies whose best motions have closed forms, a hinge, a lift and a pendulum, and their problems and plans."""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion

# Without gravity: an inertia [kg m2], and the angle [rad] that it is turned by.
HINGE = """<mujoco><option gravity="0 0 0"/><worldbody><body name="arm"><joint name="J" type="hinge" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.3 0.3 0.3"/></body></worldbody>
<actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""
HINGE_INERTIA, TURN = 0.3, np.radians(90)
# A weight on a slide, raised by a stronger motor than it is let down with.
LIFT = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="cage"><joint name="J" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor name="motor" joint="J" ctrlrange="-30 50"/></actuator></mujoco>"""
# A rod on a pivot; `limit` [N.m] is to be filled in.
PENDULUM = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-{limit} {limit}"/></actuator></mujoco>"""
# Without gravity: an arm of 1 kg m2 whose sites "mid" and "tip" are at 0.5 and 1 m; one of 0.1 kg m2 rubbed by 0.5 N.m;
# one of 0.02 kg m2 on a position servo of 50 N.m/rad and 1 N.m, which is its effort beyond 0.32 rad at every ctrl.
UNIT_ARM = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 -1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><site name="mid" pos="0.5 0 0"/><site name="tip" pos="1 0 0"/></body>
</worldbody><actuator><motor name="m" joint="J" ctrlrange="-9 9"/></actuator></mujoco>"""
RUBBED_ARM = """<mujoco><option gravity="0 0 0" timestep="1e-3"/><worldbody><body>
<joint name="J" axis="0 1 0" frictionloss="0.5"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body>
</worldbody><actuator><motor name="m" joint="J" ctrlrange="-2 2"/></actuator></mujoco>"""
SERVO_ARM = """<mujoco><compiler angle="radian"/><option gravity="0 0 0" timestep="2e-4"/><worldbody><body>
<joint name="O" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="0.02 0.02 0.02"/></body></worldbody>
<actuator><position name="servo" joint="O" kp="50" ctrlrange="-0.3 0.3" forcerange="-1 1"/></actuator></mujoco>"""
# The lines of the [motion] table of the hinge's quarter turn, without a duration.
QUARTER_TURN = 'kind = "reach"\nstart_deg = { J = 10.0 }\ngoal_deg = { J = 100.0 }\n'


def cart(effort: str = "-6 6", rail: str = "-4 4", joint: str = "") -> str:
    """Return 2 kg on a rail [m] that is pushed [N], without gravity, with further attributes of the joint."""
    return f"""<mujoco><option gravity="0 0 0"/><worldbody><body>
<joint name="x" type="slide" axis="1 0 0" range="{rail}" {joint}/><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body>
</worldbody><actuator><motor name="push" joint="x" ctrlrange="{effort}"/></actuator></mujoco>"""


def body_problem(mjcf: str, motion: str, *overrides: str) -> Problem:
    """Return the problem of a motion (the lines of a [motion] table) of an inline model."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.toml"
        path.write_text(f"[mechanism]\nmodel = '''{mjcf}'''\n[motion]\n{motion}", encoding="utf-8")
        return load_problem(path, overrides)


@cache
def body_plan(mjcf: str, motion: str, *overrides: str) -> Plan:
    """Return the plan of such a problem, made once."""
    return plan_motion(body_problem(mjcf, motion, *overrides))


def hinge(*overrides: str, duration: float | str = 1.5) -> Plan:
    """Return the plan of a pure inertia's quarter turn."""
    plan = body_plan(HINGE, QUARTER_TURN + f"duration_s = {duration!r}\n".replace("'", '"'), *overrides)
    assert plan.status == "optimal", plan.message
    return plan
