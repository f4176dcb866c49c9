"""One motor behind one gear: the motion planned with it, and the shares of the motor's limits that the motion uses."""

from typing import Any

import numpy as np
from msgspec import Struct

from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.demands import demands_of, operating_points, rms_efforts, shown_speed
from linkplan.planner.closed_chain.prescribed import at_rate_along, highest_kept_rate, prescribe, rounded_up
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.limits.kinds import effort_bounds, limits_of
from linkplan.planner.limits.limit import limit_margin
from linkplan.planner.limits.samples import actuator_speeds, samples_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.motor_list import CandidateMotor
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from linkplan.studies.variations.size.candidates import with_motor

# The range of factors on the speed at which a motion is tried.
_LOWEST_RATE, _HIGHEST_RATE = 1e-3, 1e3
# An rms effort beyond its limit by less than this share is due to rounding.
_RMS_ROUNDING = 1e-9
# The step of differences in time, as a share of the motion's duration: errors of 1e-10.
_RATE_STEP = 1e-6
PEAK, RMS, LINE = "peak effort", "rms effort", "torque-speed line"


class Loads(Struct, frozen=True, kw_only=True):
    """A motion's demands on a motor: the motor's efforts and speeds, and shares of its limits; None for a missing limit.

    `rms_effort` is over the motion and the rest after it. `needed_rest_s` is the rest that reduces it to its limit, 0 if
    none is needed; None for a periodic motion.
    """

    peak_effort: float
    rms_effort: float
    peak_speed: float
    peak_share: float
    rms_share: float | None
    line_share: float | None
    needed_rest_s: float | None

    @property
    def shares(self) -> dict[str, float]:
        """The shares of the limits that the motor has, by name."""
        named = {PEAK: self.peak_share, RMS: self.rms_share, LINE: self.line_share}
        return {name: share for name, share in named.items() if share is not None}


class SizedMotor(Struct, frozen=True, kw_only=True):
    """A motor behind a gear, with the demands of the motion planned with it. Efforts and speeds are the motor's own.

    `margin` is what the most used of its limits, `tightest`, has left, as a share of it; it is negative where that limit
    would have to be larger. `peak_limit` is the effort that plans may use, without the reserve. `loads` are those of the
    planned motion; of a prescribed one also if it exceeds the limits. `speed_up` is the highest factor on the motion's speed
    that is known to keep all limits; without a motion it is that of the shortest feasible duration, whatever the rms effort.
    `rotor_inertia_after_gear` is gear^2 times the rotor's inertia, `rotor_share` the rotor's part of the inertia that the
    motor accelerates at the start. `settings` are the keys of a problem file with this motor.
    """

    motor: str
    gear: float
    does: bool
    reason: str
    status: str
    margin: float | None
    tightest: str
    speed_up: float | None
    duration_s: float | None
    objective: float | None
    loads: Loads | None
    effort_unit: str
    speed_unit: str
    peak_limit: float
    rms_limit: float | None
    rated_power_w: float | None
    stall_effort: float | None
    no_load_speed: float | None
    rotor_inertia_after_gear: float
    rotor_share: float
    settings: dict[str, dict[str, Any]]
    curve: Beside[np.ndarray | None] = NOT_READ  # (n, 2) speed and effort behind the gear [units of `units_behind`]
    line: Beside[tuple[float, float] | None] = NOT_READ  # stall effort and no-load speed there

    @property
    def title(self) -> str:
        """Its name with its gear."""
        return f"{self.motor}, gear {self.gear:g}"


def sized_motor(
    problem: Problem, index: int, motor: CandidateMotor, gear: float, rest_s: float, say: Say
) -> tuple[SizedMotor, Plan]:
    """Return a motor behind a gear at actuator `index` of a problem, with the plan of a motion that a rest follows."""
    given = with_motor(problem, index, motor, gear)
    plan, actuator = plan_motion(given, say), given.mechanism.actuators[index]
    motion = plan.trajectory if plan.passed else None
    if motion is None and given.motion.kind == "track" and given.motion.duration_s is not None:
        motion = prescribe(given, given.start_pose())  # regardless of limits
    loads = None if motion is None else _loads(given, index, motor, motion, rest_s)
    # Without a motion, the least factor on the effort limits with which there is one, if the planner knows it.
    factor = plan.verdict.needed_factor if plan.status == "infeasible" else None
    shares = loads.shares if loads is not None else {} if factor is None else {PEAK: factor}
    tightest = max(shares, key=lambda name: shares[name], default="")
    reason = "" if plan.passed else plan.message
    beyond = {PEAK: loads.peak_share, LINE: loads.line_share or 0.0} if loads is not None and _loses(motor) else {}
    worst = max(beyond, key=lambda name: beyond[name], default="")
    if plan.passed and beyond and beyond[worst] > 1.0 + _RMS_ROUNDING:
        reason = f"with the losses of its gear it uses {100 * beyond[worst]:.4g} % of its {worst}"
    elif plan.passed and loads is not None and (loads.rms_share or 0.0) > 1.0 + _RMS_ROUNDING:
        need = loads.needed_rest_s
        rest = f"; a rest of {rounded_up(need):g} s after each motion would be enough" if need else ""
        reason = (
            f"its rms effort of {loads.rms_effort:.4g} {actuator.unit} is beyond its limit of {motor.rms_effort:.4g}"
            f" {actuator.unit}{rest}"
        )
    margin = 1.0 - shares[tightest] if shares else None
    per_unit, speed_unit = shown_speed(actuator.si_units[0])
    line, (factor, _, _) = _line(given, index), units_behind(given, index)
    inertia, rotor_share = _rotor(given, index)
    found = SizedMotor(
        motor=motor.name,
        gear=gear,
        does=not reason,
        reason=reason,
        status=plan.status,
        margin=margin if reason or margin is None else max(margin, 0.0),
        tightest=tightest,
        speed_up=_speed_up(given, index, motor, plan, motion, rest_s),
        duration_s=plan.duration_s,
        objective=plan.objective,
        loads=loads,
        effort_unit=actuator.unit,
        speed_unit=speed_unit,
        peak_limit=_peak_limit(given, index),
        rms_limit=motor.rms_effort,
        rated_power_w=motor.rated_power,
        stall_effort=None if line is None else line[0],
        no_load_speed=None if line is None else per_unit * line[1],
        rotor_inertia_after_gear=inertia,
        rotor_share=rotor_share,
        settings=_settings(given, actuator.name),
        curve=None if motion is None else _curve(given, index, motor, motion),
        line=None if line is None else (gear * line[0], factor * line[1] / gear),
    )
    return found, plan


def _loads(problem: Problem, index: int, motor: CandidateMotor, motion: Trajectory, rest_s: float) -> Loads:
    """Return a motion's demands on the motor at actuator `index`."""
    demand, line, share = demands_of(problem, motion)[index], _line(problem, index), None
    peak, own_rms = demand.peak_effort, demand.rms_effort
    speed, effort = _motor_points(problem, index, motor, motion, motion.dense_times(20))
    if _loses(motor):
        inner, width = motion.quadrature()
        of = _motor_points(problem, index, motor, motion, inner)[1]
        peak, own_rms = float(np.abs(effort).max()), float(np.sqrt(width @ of**2 / motion.duration_s))
    if line is not None:
        share = float(np.abs(effort / line[0] + speed / line[1]).max())
    limit, rms = motor.rms_effort, _with_rest(own_rms, motion.duration_s, rest_s)
    needed_rest_s = None
    if limit is not None and not motion.periodic:
        needed_rest_s = max((own_rms / limit) ** 2 - 1.0, 0.0) * motion.duration_s
    return Loads(
        peak_effort=peak,
        rms_effort=rms,
        peak_speed=demand.peak_speed,
        peak_share=peak / _peak_limit(problem, index),
        rms_share=None if limit is None else rms / limit,
        line_share=share,
        needed_rest_s=needed_rest_s,
    )


def _loses(motor: CandidateMotor) -> bool:
    """Tell whether the motor's gear has losses."""
    return any(share is not None and share < 1.0 for share in (motor.efficiency, motor.back_efficiency))


def _motor_points(
    problem: Problem, index: int, motor: CandidateMotor, motion: Trajectory, time_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the speeds (n,) and efforts (n,) of the motor at actuator `index`, with the losses of its gear.

    The planned effort u moves the rotor with J w' before the gear; the rest passes the gear. The motor's part of it is
    (u - J w') / efficiency while the motor drives, and (u - J w') back_efficiency while the load drives (Pelchen,
    Schweiger & Otter, Modelica conference 2002).
    """
    speed, effort, _ = operating_points(problem, motion, time_s)
    if not _loses(motor):
        return speed[:, index], effort[:, index]
    mechanism = problem.mechanism
    q = follow(mechanism, motion.position_at(time_s), motion.start_pose)
    v, a = motion.velocity_at(time_s), motion.acceleration_at(time_s)
    step = _RATE_STEP * motion.duration_s
    ahead, back = (
        actuator_speeds(problem, q + way * joint_rates(mechanism, q, v), v + way * a)[:, index] for way in (step, -step)
    )
    rotor = float(mechanism.model.actuator_armature[mechanism.actuators[index].index]) * (ahead - back) / (2 * step)
    passed = effort[:, index] - rotor
    drives = passed * speed[:, index] >= 0
    forward, backward = (1.0 if one is None else one for one in (motor.efficiency, motor.back_efficiency))
    return speed[:, index], rotor + np.where(drives, passed / forward, passed * backward)


def _peak_limit(problem: Problem, index: int) -> float:
    """Return the largest effort of actuator `index` in plans."""
    return float(np.abs(effort_bounds(problem)[index]).max())


def _with_rest(rms_effort: float, duration_s: float, rest_s: float) -> float:
    """Return the rms effort over a motion and a rest without effort."""
    return rms_effort * float(np.sqrt(duration_s / (duration_s + rest_s)))


def _curve(problem: Problem, index: int, motor: CandidateMotor, motion: Trajectory) -> np.ndarray:
    """Return speeds and efforts (n, 2) behind the gear, in the units of `units_behind`."""
    gear, factor = problem.mechanism.actuators[index].gear, units_behind(problem, index)[0]
    speed, effort = _motor_points(problem, index, motor, motion, motion.dense_times(20))
    return np.column_stack([factor * speed / gear, effort * gear])


def units_behind(problem: Problem, index: int) -> tuple[float, str, str]:
    """Return the factor from SI to the speed's display unit, this unit, and the effort's unit, behind an actuator's gear."""
    mechanism = problem.mechanism
    joint = mechanism.actuators[index].joint
    turns = joint is not None and mechanism.joints[joint].kind == "hinge"
    return (*shown_speed("rad" if turns else "m"), "N.m" if turns else "N")


def _line(problem: Problem, index: int) -> tuple[float, float] | None:
    """Return the stall effort and no-load speed [SI] of the motor at actuator `index`, if they are known."""
    motor = problem.motors[index]
    return None if motor is None else motor.line


def _rotor(problem: Problem, index: int) -> tuple[float, float]:
    """Return the rotor's inertia J behind its gear, and its share J b^T M_r^-1 b of the inertia that the motor accelerates.

    b is the motor's column of Gamma^T B at the start, so 1 / (b^T M_r^-1 b) is the inertia on the motor's shaft with the
    rotor.
    """
    mechanism, pose = problem.mechanism, problem.start_pose()
    actuator = mechanism.actuators[index]
    inertia = float(mechanism.model.actuator_armature[actuator.index])
    b = np.array(mechanism.dynamics.effort_map(pose))[:, index]
    shaft = float(b @ np.linalg.solve(np.array(mechanism.dynamics.reduced_inertia(pose)), b))
    return actuator.gear**2 * inertia, inertia * shaft


def _speed_up(
    problem: Problem, index: int, motor: CandidateMotor, plan: Plan, motion: Trajectory | None, rest_s: float
) -> float | None:
    """Return the highest known factor on the speed of a motion in a given duration; None if none is known.

    A planned motion is run faster along its own path, with efforts by inverse dynamics; another path may allow more.
    """
    mechanism, duration_s = problem.mechanism, problem.motion.duration_s
    if duration_s is None or problem.motion.kind == "hold":
        return None
    if motion is None:
        shortest_s = plan.verdict.remedy.get("motion.duration_s") if plan.status == "infeasible" else None
        return None if shortest_s is None else duration_s / shortest_s
    if mechanism.n_u < mechanism.dof or not mechanism.actuated.all():
        return None

    def is_cool(faster: Trajectory) -> bool:
        if _loses(motor):
            return all(
                share <= 1.0 + _RMS_ROUNDING for share in _loads(problem, index, motor, faster, rest_s).shares.values()
            )
        rms = _with_rest(float(rms_efforts(faster)[index]), faster.duration_s, rest_s)
        return motor.rms_effort is None or rms <= motor.rms_effort

    def keeps(rate: float) -> bool:
        faster = at_rate_along(problem, motion, rate)
        if not is_cool(faster):
            return False
        samples = samples_of(problem, faster)
        return all(limit_margin(limit, samples).kept for limit in limits_of(problem))

    rate = highest_kept_rate(keeps, _LOWEST_RATE, _HIGHEST_RATE)
    # A certified motion at its limits exceeds them by rounding.
    return max(rate or 1.0, 1.0) if plan.passed and is_cool(motion) else rate


def _settings(problem: Problem, name: str) -> dict[str, dict[str, Any]]:
    """Return the keys of a problem file that give an actuator its motor, by section."""
    tables, found = problem.to_dict(), {}
    for section, key in (("mechanism", "gear"), ("mechanism", "rotor_inertia"), ("limits", "effort")):
        table = tables[section].get(key, {})
        if name in table:
            found.setdefault(section, {})[key] = {name: table[name]}
    motors = tables.get("motors", {})
    return found | ({"motors": {name: motors[name]}} if name in motors else {})
