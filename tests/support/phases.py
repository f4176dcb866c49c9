"""Mechanisms that push off the ground, walk and carry loads, and the step of a walker (parameters of RABBIT)."""

import functools

import numpy as np

from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.search.phases import plan_phases

ARM = """<mujoco model="arm"><option gravity="0 0 0"/><worldbody><body name="arm"><joint name="J" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor name="J" joint="J" ctrlrange="-1000 1000" ctrllimited="true"/></actuator></mujoco>"""
# A body of 8 kg and a foot of 2 kg, pushed apart by a leg of 300 N with a stroke of 0.3 m.
HOPPER = """<mujoco model="two-mass hopper"><option gravity="0 0 -9.81"/><worldbody>
<body name="foot"><joint name="z" type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/>
<site name="sole"/><body name="body"><joint name="leg" type="slide" axis="0 0 1" range="0 0.3" limited="true"/>
<inertial pos="0 0 0" mass="8" diaginertia=".1 .1 .1"/></body></body></worldbody>
<actuator><motor name="leg" joint="leg" ctrlrange="-300 300" ctrllimited="true"/></actuator></mujoco>"""
# A mass of 10 kg on a foot without mass: a rotor of 2e-4 kg m2 pushes them apart.
ROTOR = """<mujoco model="rotor"><option gravity="0 0 -9.81"/><worldbody>
<body name="foot"><joint name="z" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-9 1e-9 1e-9"/><site name="sole"/>
<body name="mass"><joint name="leg" type="slide" axis="0 0 1" range="0 0.3" limited="true"/>
<inertial pos="0 0 0" mass="10" diaginertia=".1 .1 .1"/></body></body></worldbody>
<actuator><motor name="rotor" joint="leg" gear="240.553752199" ctrlrange="-6 6" ctrllimited="true" armature="2e-4"/>
</actuator></mujoco>"""
SOLE = {"toe": {"site": "sole"}}
HIGHEST = {"maximize": {"com_height": "apex"}}
LOAD = {"body": "arm", "mass_kg": 3.0, "com_m": [1.0, 0.0, 0.0]}
TOE = {"toe": {"site": "sole", "friction": 0.6}}
_SHIN = '<inertial pos="0 0 -.128" mass="3.2" diaginertia=".93 .93 .93"/>'
_THIGH = '<inertial pos="0 0 -.163" mass="6.8" diaginertia="1.08 1.08 1.08"/>'


def _leg(side):
    return (
        f'<body name="{side}_femur"><joint name="{side}_hip" axis="0 -1 0"/>{_THIGH}'
        f'<body name="{side}_tibia" pos="0 0 -.4"><joint name="{side}_knee" axis="0 -1 0"/>{_SHIN}'
        f'<site name="{side}_foot" pos="0 0 -.4"/></body></body>'
    )


def _motor(joint):
    return f'<motor name="{joint}" joint="{joint}" ctrlrange="-100 100" ctrllimited="true"/>'


WALKER = f"""<mujoco model="rabbit"><compiler balanceinertia="false" boundmass="0"/><option gravity="0 0 -9.81"/><worldbody>
<body name="torso"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="pitch" axis="0 -1 0"/><inertial pos="0 0 .2" mass="20" diaginertia="2.22 2.22 2.22"/>{_leg("st")}{_leg("sw")}
</body></worldbody><actuator>{"".join(map(_motor, ("st_knee", "st_hip", "sw_hip", "sw_knee")))}</actuator><keyframe>
<key name="home" qpos="-.22 .75 -.23 .73 -.43 -.123 -.011"/></keyframe></mujoco>"""
MIRROR = {"st_hip": "sw_hip", "st_knee": "sw_knee"}


# A point of 1 kg on two legs of 1 m with next to nothing at their feet, on a slope of 0.009 rad.
SLOPE = f"{9.81 * np.sin(0.009):.12f} 0 {-9.81 * np.cos(0.009):.12f}"
_FEET = "".join(
    f'<body name="{leg}"><joint name="{leg}" axis="0 1 0"/><inertial pos="0 0 -1" mass="1e-5" diaginertia="1e-9 1e-9 1e-9"/>'
    f'<site name="{leg}_foot" pos="0 0 -1"/></body>'
    for leg in ("st", "sw")
)
SIMPLEST = f"""<mujoco model="simplest walker"><option gravity="{SLOPE}"/><worldbody><body name="hip" pos="0 0 1">
<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1e-7 1e-7 1e-7"/>{_FEET}</body></worldbody>
<actuator><motor name="hip" joint="sw" ctrlrange="-1 1" ctrllimited="true"/></actuator>
<keyframe><key name="home" qpos="-0.2 -0.02 -0.2 0.2"/></keyframe></mujoco>"""


@functools.cache
def step(friction, **motion):
    tables = {
        "contacts": {"foot": {"site": "st_foot", "friction": friction}},
        "motion": {"repeat": True, "mirror": MIRROR, "duration_s": 0.7, **motion},
    }
    return plan_phases(PhasedProblem.of(WALKER, [{"name": "step", "on": ["foot"]}], tables))
