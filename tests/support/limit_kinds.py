"""Every kind of limit that a mechanism can have: its values along a motion in numbers, and how to set it.

Values come from the certificate's functions in numbers: a second route that shares only the model with the proof.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.poses.along import accelerations, joint_jerk, joint_rates, needed_controls, sampled, site_motion
from linkplan.models.poses.body_angles import turning_bodies
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.joint_forces import pins_of
from linkplan.planner.limits.efforts import INVERSE_DYNAMICS_SHARE, effort_rates
from linkplan.planner.limits.samples import Samples
from linkplan.planner.problem.instant import Robust
from linkplan.planner.problem.keys.limits import Motor
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import BodyLimit, SiteLimit, angles_of
from linkplan.planner.trajectory import Trajectory
from tests.support.random_motions import needed, samples_at


@dataclass(frozen=True, kw_only=True, eq=False)
class Kind:
    """One limit of one mechanism: `values` of (samples), `limited` by (problem, low, high), and its claim's name.

    `of_effort` says that a coefficient of the planned effort is moved, and not one of the position. `beyond` is the mark's
    allowance as a share of the limit. `signs` are the ends that the limit has.
    """

    words: str
    values: Callable[[Samples], np.ndarray]
    limited: Callable[[Problem, float, float], Problem]
    of_effort: bool = False
    beyond: float = 0.0
    signs: tuple[int, ...] = (1, -1)


def _rows(name: str, row: int) -> Callable[[Problem, float, float], Problem]:
    def limited(problem: Problem, low: float, high: float) -> Problem:
        rows = np.array(getattr(problem.limits, name))
        rows[row] = low, high
        return problem.varied(limits=replace(problem.limits, **{name: rows}))

    return limited


def _of_needed(at: Samples) -> np.ndarray:
    return needed(at.problem, at.trajectory, at.time)


def kinds_of(problem: Problem, motion: Trajectory, rng: np.random.Generator) -> list[Kind]:
    """Return the kinds of limits that a mechanism can have, one of each kind with a random item."""
    mechanism = problem.mechanism
    j, i = int(rng.integers(mechanism.n_u)), int(rng.integers(mechanism.n_q))
    actuator, joint = mechanism.actuators[j], mechanism.joints[i]
    effort = _rows("effort", j)
    return [
        Kind(
            words=f"effort of {actuator.name} by inverse dynamics",
            values=lambda at: _of_needed(at)[:, j],
            limited=effort,
            beyond=INVERSE_DYNAMICS_SHARE,
        ),
        Kind(words=f"planned effort of {actuator.name}", values=lambda at: at.u[:, j], limited=effort, of_effort=True),
        Kind(words=f"position of {joint.name}", values=lambda at: at.q[:, i], limited=_rows("position", i)),
        Kind(
            words=f"speed of {joint.name}",
            values=lambda at: joint_rates(mechanism, at.q, at.v)[:, i],
            limited=_rows("speed", i),
        ),
        Kind(
            words=f"acceleration of {joint.name}",
            values=lambda at: accelerations(mechanism, at.q, at.v, at.a)[:, i],
            limited=_rows("acceleration", i),
        ),
        Kind(
            words=f"jerk of {joint.name}",
            values=lambda at: sampled(joint_jerk(mechanism), at.q, at.v, at.a, at.jerk)[:, i, 0],
            limited=_rows("jerk", i),
        ),
        Kind(
            words=f"effort rate of {actuator.name}",
            values=lambda at: effort_rates(at.trajectory, at.time)[0][:, j],
            limited=_rows("effort_rate", j),
            of_effort=True,
        ),
        Kind(
            words=f"power of {actuator.name}",
            values=lambda at: at.u[:, j] * at.actuator_speeds[:, j],
            limited=_rows("power", j),
            of_effort=True,
        ),
        *_sites(problem, motion, rng),
        *_bodies(problem, rng),
        *_robust(problem, j),
        *_line(problem, motion, j),
        *_pins(problem, rng),
        *_loops(problem, rng),
        *_parts(problem, rng),
        *_servo(problem, j),
    ]


def _sites(problem: Problem, motion: Trajectory, rng: np.random.Generator) -> list[Kind]:
    mechanism, found = problem.mechanism, []
    if not mechanism.model.nsite:
        return []
    index = int(rng.integers(mechanism.model.nsite))
    name = mechanism.model.site(index).name
    normal = rng.normal(size=3)
    begin, end = samples_at(problem, motion, motion.breaks_s[[0, -1]]).q
    corners = [places_of(mechanism, index, q[None])[0] for q in (begin, end)]
    middle = 0.5 * (corners[0] + corners[1]) + 0.05 * mechanism.extent_m * rng.normal(size=3)
    shapes = (
        ("z", {"normal": np.array([0.0, 0.0, 1.0])}),
        ("wall", {"normal": normal / np.linalg.norm(normal), "origin": 0.1}),
        ("tube", {"along": np.array([corners[0] + 0.01 * mechanism.extent_m, middle, corners[1]])}),
    )
    for what, shape in shapes:
        free = SiteLimit(
            site=name, index=index, what=what, name=name, low=-np.inf if what != "tube" else 0.0, high=np.inf, **shape
        )

        def limited(problem: Problem, low: float, high: float, free: SiteLimit = free) -> Problem:
            site = replace(free, low=max(low, free.low), high=min(high, free.high), scale=high)
            return problem.varied(limits=replace(problem.limits, site=(*problem.limits.site, site)))

        found.append(
            Kind(
                words=f"{what} of site {name}",
                values=lambda at, free=free: free.value(places_of(mechanism, free.index, at.q)),
                limited=limited,
                signs=(1,) if what == "tube" else (1, -1),
            )
        )

    def largest(order: int) -> Kind:
        key, what = {1: ("site_speed", "speed"), 2: ("site_acceleration", "acceleration"), 3: ("site_jerk", "jerk")}[order]

        def size(at: Samples) -> np.ndarray:
            further = [at.jerk] if order == 3 else []
            return np.linalg.norm(sampled(site_motion(mechanism, order), at.q, at.v, at.a, *further)[:, :, index], axis=1)

        def limited(problem: Problem, low: float, high: float) -> Problem:
            return problem.varied(limits=replace(problem.limits, **{key: {name: min(-low, high)}}))

        return Kind(words=f"{what} of site {name}", values=size, limited=limited, signs=(1,))

    return [*found, *map(largest, (1, 2, 3))]


def _bodies(problem: Problem, rng: np.random.Generator) -> list[Kind]:
    mechanism = problem.mechanism
    names = list(turning_bodies(mechanism))
    if not names:
        return []
    name = names[int(rng.integers(len(names)))]
    index = int(mechanism.model.body(name).id)

    def limited(problem: Problem, low: float, high: float) -> Problem:
        limit = BodyLimit(body=name, index=index, low=low, high=high)
        return problem.varied(limits=replace(problem.limits, body=(limit,)))

    return [Kind(words=f"angle of body {name}", values=lambda at: angles_of(mechanism, index, at.q), limited=limited)]


def _robust(problem: Problem, j: int) -> list[Kind]:
    mechanism = problem.mechanism
    if mechanism.n_u < mechanism.dof:
        return []
    payload = {} if mechanism.payload is None else {"payload_factor": (1.0, 1.3)}
    driven = mechanism.independent_joints[0].name
    robust = Robust(
        torque_constant_factor=(0.9, 1.0),
        viscous_friction={driven: (0.0, 0.01)},
        coulomb_friction={driven: (0.0, 0.02)},
        **payload,
    )
    corner = len(robust.corners) // 3
    words = robust.corners[corner].description

    def limited(problem: Problem, low: float, high: float) -> Problem:
        return _rows("effort", j)(problem, low, high).varied(robust=robust)

    return [
        Kind(
            words=f"effort of {mechanism.actuators[j].name} with {words}",
            values=lambda at: replace(at, problem=at.problem.varied(robust=robust)).corner_efforts[:, corner, j],
            limited=limited,
            beyond=INVERSE_DYNAMICS_SHARE,
        )
    ]


def _line(problem: Problem, motion: Trajectory, j: int) -> list[Kind]:
    at = samples_at(problem, motion, motion.dense_times(20))
    most, fast = np.abs(at.u[:, j]).max(), np.abs(at.actuator_speeds[:, j]).max()

    def limited(problem: Problem, low: float, high: float) -> Problem:
        size = min(abs(low), abs(high))
        motors = list(problem.motors)
        motors[j] = Motor(stall_effort=float(most * size), no_load_speed_m_s=float(fast * size))
        return problem.varied(motors=tuple(motors))

    def values(at: Samples) -> np.ndarray:
        return np.abs(at.u[:, j] / most + at.actuator_speeds[:, j] / fast)

    name = problem.mechanism.actuators[j].name
    return [Kind(words=f"torque-speed line of {name}", values=values, limited=limited, of_effort=True, signs=(1,))]


def _pins(problem: Problem, rng: np.random.Generator) -> list[Kind]:
    pins = pins_of(problem.mechanism)
    if not pins:
        return []
    name = pins[int(rng.integers(len(pins)))].name

    def limited(problem: Problem, _: float, high: float) -> Problem:
        return problem.varied(limits=replace(problem.limits, pin_force={name: high}))

    return [
        Kind(
            words=f"squared pin force of {name}",
            values=lambda at: at.joint_forces.force[name],
            limited=limited,
            of_effort=bool(rng.integers(2)),
            signs=(1,),
        )
    ]


def _loops(problem: Problem, rng: np.random.Generator) -> list[Kind]:
    mechanism, found = problem.mechanism, []
    if not len(mechanism.dependent):
        return []
    c = int(rng.integers(len(mechanism.closure_names)))

    def rated(problem: Problem, _: float, high: float) -> Problem:
        forces = np.array(problem.limits.closure_force)
        forces[c] = high
        return problem.varied(limits=replace(problem.limits, closure_force=forces))

    found.append(
        Kind(
            words=f"squared closure force of {mechanism.closure_names[c]}",
            values=lambda at: at.closure_forces[:, c],
            limited=rated,
            of_effort=bool(rng.integers(2)),
            signs=(1,),
        )
    )

    def apart(problem: Problem, low: float, _: float) -> Problem:
        return problem.varied(limits=replace(problem.limits, singular_margin=low))

    found.append(
        Kind(
            words="distance from a singular pose, block 1",
            values=lambda at: at.block_ratios[:, 0],
            limited=apart,
            signs=(-1,),
        )
    )
    return found


def _parts(problem: Problem, rng: np.random.Generator) -> list[Kind]:
    """Return the limits that a model holds: lengths of tendons and angles of ball joints."""
    mechanism, found = problem.mechanism, []
    for name, what in (("tendons", "length of tendon"), ("balls", "half the angle of ball joint")):
        items = getattr(mechanism, name)
        if not items:
            continue
        k = int(rng.integers(len(items)))

        def limited(problem: Problem, low: float, high: float, name: str = name, k: int = k) -> Problem:
            items = list(getattr(problem.mechanism, name))
            ends = {"low": low, "high": high} if name == "tendons" else {"largest": high}
            items[k] = replace(items[k], **ends)
            return problem.varied(mechanism=replace(problem.mechanism, **{name: tuple(items)}))

        def values(at: Samples, name: str = name, k: int = k) -> np.ndarray:
            if name == "tendons":
                return at.of_pose("tendon_length")[:, k]
            return 2 * np.arcsin(np.sqrt(at.of_pose("ball_turns")[:, k]))

        signs = (1, -1) if name == "tendons" else (1,)
        found.append(Kind(words=f"{what} {items[k].name}", values=values, limited=limited, signs=signs))
    return found


def _servo(problem: Problem, j: int) -> list[Kind]:
    mechanism = problem.mechanism
    if not mechanism.actuators[j].is_servo:
        return []

    def limited(problem: Problem, low: float, high: float) -> Problem:
        actuators = list(problem.mechanism.actuators)
        actuators[j] = replace(actuators[j], control_lower=low, control_upper=high, lower=-np.inf, upper=np.inf)
        return problem.varied(mechanism=replace(problem.mechanism, actuators=tuple(actuators)))

    return [
        Kind(
            words=f"ctrl of {mechanism.actuators[j].name}",
            values=lambda at: needed_controls(mechanism, at.q, at.v, at.u)[:, j],
            limited=limited,
            of_effort=True,
        )
    ]
