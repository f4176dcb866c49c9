"""Random least times of one motor under limits on accelerations of joints and sites, against a grid in (s, s'^2).

`python -m tests.bench.acceleration_limits [FIRST [N]]` prints one line for each problem: status, least time, that of the
grid, the difference as a share, and the limits. The four-bar drives a rocker, the slider-crank a slider. The arm's site
moves on a circle, along which the limit is a curve that the motion follows.
"""

import sys
import time

import numpy as np

from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.grid_least_time import least_time_on_grid

_HEAD = '<mujoco><compiler angle="degree" autolimits="true"/><option gravity="0 0 {gravity}"/><worldbody>'
_FOUR_BAR = """
<body><joint name="P" axis="0 1 0" armature="0.002" damping="{damping}" range="-150 150"/>
<geom type="capsule" fromto="0 0 0 0.08 0 0.02" size="0.01" mass="{mass}"/>
<body name="coupler" pos="0.08 0 0.02"><joint name="Q" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.15 0 0.1" size="0.008" mass="0.6"/><site name="tool" pos="0.09 0 0.11"/></body></body>
<body name="rocker" pos="0.28 0 -0.02"><joint name="R" axis="0 1 0" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 -0.05 0 0.14" size="0.01" mass="0.5"/><site name="rk" pos="-0.05 0 0.14"/></body>
</worldbody><equality><connect name="S" body1="coupler" body2="rocker" anchor="0.15 0 0.1"/></equality>"""
_SLIDER = """
<body><joint name="P" axis="0 1 0" damping="{damping}"/><inertial pos="0.1 0 0" mass="{mass}" diaginertia="0.02 0.02 0.02"/>
<body pos="0.3 0 0"><joint name="Q" axis="0 1 0"/><inertial pos="0.4 0 0" mass="1" diaginertia="0.05 0.05 0.05"/>
<site name="tool" pos="0.3 0 0.1"/><site name="tip" pos="0.8 0 0"/></body></body>
<body pos="1.1 0 0"><joint name="R" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<site name="rk"/></body></worldbody><equality><connect site1="tip" site2="rk"/></equality>"""
_ARM = """
<body><joint name="P" axis="0 1 0" damping="{damping}"/><inertial pos="0.2 0 0" mass="{mass}" diaginertia="0.02 0.02 0.02"/>
<site name="tool" pos="0.4 0 0"/></body></worldbody>"""
_MOTOR = '<actuator><motor name="mot" joint="P" gear="7" ctrlrange="-{low} {high}"/></actuator></mujoco>'
_BODIES = {"four-bar": _FOUR_BAR, "slider": _SLIDER, "arm": _ARM}
# Cells of the coarser grid.
N_CELLS = 800


def text_of(kind: str, **values: float) -> str:
    """Return the MJCF of a mechanism with a motor of efforts from -`low` to `high`."""
    return (_HEAD + _BODIES[kind] + _MOTOR).format(**values)


def drawn(number: int) -> tuple[Problem, dict]:
    """Return a random problem, and its limits."""
    rng = np.random.default_rng((79, number))
    kind = list(_BODIES)[int(rng.choice(3, p=(0.5, 0.35, 0.15)))]
    strong = {"four-bar": 1.2, "slider": 8.0, "arm": 5.0}[kind] * rng.uniform(0.8, 2.0, size=2)
    values = {"gravity": rng.choice([0.0, -9.81]), "damping": rng.choice([0.0, 0.05]), "mass": rng.uniform(0.2, 1.0)}
    text = text_of(kind, **values, low=strong[0], high=strong[1])
    start, goal = rng.uniform(-100.0, 100.0, size=2)
    goal = start + np.sign(goal - start) * max(abs(goal - start), 25.0)
    limits: dict = {}
    joints = {"four-bar": ("R", "R", "Q", "P"), "slider": ("R", "Q", "P"), "arm": ("P",)}[kind]
    for _ in range(int(rng.integers(1, 3))):
        if rng.random() < 0.5:
            limits["site_acceleration_m_s2"] = {"tool": float(np.exp(rng.uniform(np.log(5), np.log(150))))}
            continue
        joint, size = rng.choice(joints), float(np.exp(rng.uniform(np.log(1500), np.log(2e4))))
        slides = kind == "slider" and joint == "R"
        limits["acceleration_m_s2" if slides else "acceleration_deg_s2"] = {str(joint): size / 200 if slides else size}
    if rng.random() < 0.25:
        limits["speed_deg_s"] = {"P": float(rng.uniform(200, 800))}
    ends = {"start_deg": {"P": float(start)}, "goal_deg": {"P": float(goal)}}
    return Problem.reach(text, **ends, minimize="time", limits=limits), limits


def main(first: int = 0, n: int = 40) -> None:
    for number in range(first, first + n):
        problem, limits = drawn(number)
        begun = time.process_time()
        plan = plan_motion(problem)
        taken = time.process_time() - begun
        grid = least_time_on_grid(problem, N_CELLS)
        found = np.nan if plan.objective is None else plan.objective
        line = f"{number:3} {plan.status:10} {found:.7f} {grid:.7f} {found / grid - 1:+.1e} {taken:5.1f} s"
        print(line, limits, "" if plan.status == "optimal" else plan.message, flush=True)


if __name__ == "__main__":
    main(*(int(one) for one in sys.argv[1:]))
