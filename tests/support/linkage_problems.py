"""Random problems of random linkages with their answers: least time, least effort, limits on power and effort.

Nothing here is linkplan's: poses and dynamics are MuJoCo's, least times the phase plane's, least efforts are by Pontryagin
or, of five-bars with two motors, by a spectral method on closed forms.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tests.support.driven_five_bar import least_effort, random_five_bar
from tests.support.least_effort import least_effort_of
from tests.support.least_time import least_time_of
from tests.support.mujoco_curves import Poses, closed_poses, curves_of_poses
from tests.support.open_linkages import Linkage, random_linkage

_NO_POWER = (-np.inf, np.inf)
# Loops keep this share of their least singular value at home, on the way and this share of it beyond; the least of efforts
# may swing back first.
_CLEAR, _BEYOND, _SWINGS = 0.3, 0.05, 0.6
# Elbows that are flipped are farther from the start than the goal, by this [rad].
_APART = 0.1
FAMILIES = ("watt", "stephenson", "slider-crank", "rssr", "five-bar")
ASKED = ("time", "effort", "time within a power", "effort within a limit")


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkageProblem:
    """A file's tables, its family, what is asked in words, and the best value; how exact that is, relative."""

    tables: dict
    family: str
    asked: str
    best: float
    exact: float = 1e-6


def drawn(seed: int, number: int) -> LinkageProblem:
    """Return a random problem by its number."""
    rng = np.random.default_rng([seed, number, 71])
    family = FAMILIES[number % len(FAMILIES)]
    asked = ASKED[number // len(FAMILIES) % len(ASKED)]
    if family == "five-bar":
        return _of_five_bar(rng)
    while True:
        found = _attempted(rng, random_linkage(rng, family), asked)
        if found is not None:
            return found


def _of_five_bar(rng: np.random.Generator) -> LinkageProblem:
    while True:
        bar, goal, duration = random_five_bar(rng)
        best = least_effort(bar, goal, duration)
        if best is None:
            continue
        named = {"goal_deg": {"O1": float(np.degrees(goal[0])), "O2": float(np.degrees(goal[1]))}}
        nearest = np.all(np.abs(bar.flipped(goal)) > np.abs(goal) + _APART)
        if rng.random() < 0.5 and nearest:  # of several poses with the pin there the nearest is meant
            named = {"goal_at": {"P": [float(x) for x in bar.pin_at(goal)]}}
        tables = {
            "mechanism": {"model": bar.mjcf()},
            "motion": {"kind": "reach", "start_deg": {"O1": 0.0, "O2": 0.0}, "duration_s": duration} | named,
            "objective": {"minimize": "effort"},
        }
        return LinkageProblem(tables=tables, family="five-bar", asked="effort", best=best)


def _attempted(rng: np.random.Generator, linkage: Linkage, asked: str) -> LinkageProblem | None:
    model = mujoco.MjModel.from_xml_string(linkage.mjcf)
    goal = float(rng.choice([-1, 1]) * rng.uniform(0.4, 2.5))
    beyond = _BEYOND if asked.startswith("time") else _SWINGS
    poses = closed_poses(model, -beyond * goal, (1 + beyond) * goal)
    if poses is None or poses.clear.min() < _CLEAR:
        return None
    curves, span = curves_of_poses(model, poses), np.linspace(0.0, goal, 501)
    weight = float(np.abs(curves.still(span)).max()) / abs(linkage.gear)
    limit = weight * float(rng.uniform(1.2, 5.0))
    quickest = least_time_of(curves, 0.0, goal, (-limit, limit), _NO_POWER)
    motion: dict = {"kind": "reach", "start_deg": {"O": 0.0}} | _goal(rng, model, poses, goal)
    tables = {"mechanism": {"model": linkage.mjcf}, "motion": motion}
    tables |= {"limits": {"effort": {"act": [-limit, limit]}} | _ranges(rng, linkage, model, poses)}
    if asked.startswith("time"):
        power = _NO_POWER
        if asked.endswith("power"):
            most = float(rng.uniform(0.25, 0.8)) * limit * abs(linkage.gear * goal) / quickest
            tables["limits"]["power_w"], power = {"act": [-most, most]}, (-most, most)
        best = least_time_of(curves, 0.0, goal, (-limit, limit), power)
        motion["duration_s"] = "free"
    else:
        within = asked.endswith("limit")
        motion["duration_s"] = duration = quickest * float(rng.uniform(1.1, 1.6) if within else rng.uniform(0.8, 1.8))
        if not within:
            tables["limits"]["effort"] = {"act": [-100.0 * limit, 100.0 * limit]}
        best = least_effort_of(curves, 0.0, goal, duration, limit if within else np.inf)
        if best is None:
            return None
    tables["objective"] = {"minimize": asked.split()[0]}
    return LinkageProblem(tables=tables, family=linkage.kind, asked=asked, best=best)


def _goal(rng: np.random.Generator, model: mujoco.MjModel, poses: Poses, goal: float) -> dict:
    """Return a goal's keys: the driven joint's angle, a follower's, or where the site is."""
    if rng.random() < 0.7:
        return {"goal_deg": {"O": float(np.degrees(goal))}}
    data = mujoco.MjData(model)
    data.qpos[:] = _at(poses, goal)
    mujoco.mj_kinematics(model, data)
    return {"goal_at": {"tip": [float(x) for x in data.site("tip").xpos]}}


def _ranges(rng: np.random.Generator, linkage: Linkage, model: mujoco.MjModel, poses: Poses) -> dict:
    """Return a range of a joint that follows, which the way keeps."""
    if rng.random() < 0.5:
        return {}
    joint = str(rng.choice(linkage.followers))
    angle = np.degrees(poses.q[:, model.joint(joint).qposadr[0]])  # on the way and beyond: nothing that is best is cut off
    slack = float(rng.choice([0.5, 10.0]))
    return {"range_deg": {joint: [float(angle.min()) - slack, float(angle.max()) + slack]}}


def _at(poses: Poses, place: float) -> np.ndarray:
    """Return the pose at a place, between the samples by their slopes too (cubic)."""
    way = slice(None, None, 1 if poses.place[-1] > poses.place[0] else -1)
    return CubicHermiteSpline(poses.place[way], poses.q[way], poses.slope[way])(place)
