"""Limits along a motion beyond those of effort, range and speed: what each comes to, where it is worst, what is left."""

from dataclasses import dataclass

import numpy as np

from linkplan.models.actuation.actuators import Actuator, ranged_control
from linkplan.models.poses.along import sampled
from linkplan.planner.problem.corner_efforts import corner_efforts_along
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import bernstein_matrix

# A limit is kept where it is overrun by no more than this share of itself: rounding.
SLACK = 1e-9
# Where a servo gives the clamp of its force whatever its ctrl, a planned effort is the clamp to this share of it: a motion
# enters there between two nodes. Efforts may be off by 200 times as much between nodes (DYNAMICS_SHARE). Measured 4e-5.
_AT_CLAMP = 1e-4
# At how many instants of an interval limits are checked: at least, and for each node.
_SAMPLES, _SAMPLES_A_NODE = 12, 3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Margin:
    """The worst instant of one limit: `value` against `limit` in `unit`; `left` is negative where it is overrun.

    `what` is the limit's key in a problem file ("effort_rate", "power", "closure_force", "singular_margin", "motor"),
    or "robust" for an effort limit at a corner of [robust], "control" for a servo's ctrlrange, "tendon" for a tendon's
    range, "site" and "tube" for limits.site; `item` the actuator, closure, tendon or site limit of that name.
    """

    what: str
    item: int
    name: str
    value: float
    limit: float
    left: float
    unit: str
    time_s: float
    overrun: np.ndarray  # (n_intervals,) by how much of itself the limit is overrun in each, 0 where it is kept
    upper: bool  # whether the limit is an upper one

    @property
    def key(self) -> str:
        """The limit's key in a problem file: a tube is one of a site's."""
        return "site" if self.what == "tube" else self.what

    @property
    def kept(self) -> bool:
        """Whether the limit is kept, but for rounding."""
        return self.left >= -SLACK * max(1.0, abs(self.limit))

    @property
    def title(self) -> str:
        """What is limited, in words."""
        return {
            "effort_rate": f"the effort rate of {self.name}",
            "power": f"the power of {self.name}",
            "robust": f"the effort of {self.name}",
            "control": f"the ctrl of {self.name}",
            "motor": f"the torque-speed line of {self.name}",
            "closure_force": f"the closure force of {self.name}",
            "singular_margin": "the distance from a singular pose",
            "tendon": f"the length of tendon {self.name}",
            "site": self.name,
            "tube": self.name,
        }[self.what]

    def sentence(self, verb: str = "comes to") -> str:
        """Return what the limit comes to, in words."""
        beyond = "short of" if self.what == "singular_margin" else "beyond"
        value, limit = (self.value, self.limit) if self.what in ("site", "tendon") else (abs(self.value), abs(self.limit))
        amount = f"{value:.4g} {self.unit}".rstrip()
        off = f"{abs(self.left):.3g} {self.unit}".rstrip()
        return f"{self.title} {verb} {amount} at t = {self.time_s:.4g} s, {off} {beyond} its limit of {limit:.4g}"


def sample_points(n_nodes: int) -> np.ndarray:
    """Return the shares (n,) of an interval at which motions of so many nodes are sampled: close together at its ends.

    There the nodes of high degrees stand close, and what a polynomial does between them.
    """
    n = max(_SAMPLES, _SAMPLES_A_NODE * n_nodes)
    points = 0.5 - 0.5 * np.cos(np.pi * np.arange(n + 1) / n)
    points[-1] = 1.0 - 1e-12  # the interval's own side of its end
    return points


def least_between(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the least value (n,) on each interval of a curve that is smooth there: sampled, or at a parabola's vertex.

    Args:
        values: samples (n, n_points), or all in a row.
        points: where they stand (n_points,), shares of an interval.
    """
    rows = values.reshape(-1, len(points))
    with np.errstate(all="ignore"):  # a curve with infinite values is as low as its samples
        slope = np.diff(rows, axis=1) / np.diff(points)
        bend = np.diff(slope, axis=1) / (points[2:] - points[:-2])
        at = slope[:, :-1] + bend * (points[1:-1] - points[:-2])
        vertex = points[1:-1] - at / (2 * bend)
        inside = (bend > 0) & (vertex >= points[:-2]) & (vertex <= points[2:])
        least = np.where(inside, rows[:, 1:-1] - at**2 / (4 * bend), np.inf)
    return np.minimum(rows.min(axis=1), np.where(np.isfinite(rows).all(axis=1), least.min(axis=1, initial=np.inf), np.inf))


def actuator_speeds(problem: PlanningProblem, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the actuators' speeds (n, n_u) [rad/s or m/s], (Gamma^T B)^T v, at poses q (n, n_q)."""
    return np.einsum("ksu,ks->ku", sampled(problem.mechanism.dynamics.effort_map, q), v)


def closure_forces(problem: PlanningProblem, q, v, a, u) -> np.ndarray:
    """Return the size (n, n_closures) [N] of every closure's force."""
    mechanism = problem.mechanism
    force = sampled(mechanism.dynamics.closure_force, q, v, a, u)[:, :, 0]
    sizes = [np.linalg.norm(force[:, mechanism.closure_slice(c)], axis=1) for c in range(len(mechanism.closure_names))]
    return np.array(sizes).T.reshape(len(q), -1)


def margin_of(
    what: str,
    item: int,
    name: str,
    values: np.ndarray,
    bounds,
    unit: str,
    points: np.ndarray,
    time: np.ndarray,
    size=None,
    bent: np.ndarray | None = None,
) -> Margin:
    """Return what is left of one limit [low, high] of values (n,) at times (n,), sampled at `points` of each interval.

    `size` is what overruns are shares of, the limit's own by default. Where samples are `bent` (n,), beside a kink, no
    parabola is laid through those of the interval.
    """
    low, high = bounds
    inside = np.minimum(values - low, high - values)
    at = int(np.argmin(inside))
    limit = high if high - values[at] <= values[at] - low else low
    least = least_between(inside, points)
    if bent is not None:
        rows, kinked = inside.reshape(-1, len(points)), bent.reshape(-1, len(points)).any(axis=1)
        least = np.where(kinked, rows.min(axis=1), least)
    left = float(least.min())
    value = values[at] if not np.isfinite(left) else limit - left if limit == high else limit + left
    return Margin(
        what=what,
        item=item,
        name=name,
        value=float(value),
        limit=float(limit),
        left=left,
        unit=unit,
        time_s=float(time[at]),
        overrun=np.maximum(0.0, -least) / (size or abs(limit) or 1.0),
        upper=bool(limit == high),
    )


def margins(
    problem: PlanningProblem, trajectory: Trajectory, points: np.ndarray, time: np.ndarray, q, v, a, u
) -> tuple[Margin, ...]:
    """Return what is left of every such limit of a problem along a motion, sampled at `points` of each interval."""
    mechanism, limits, found = problem.mechanism, problem.limits, []
    names = [actuator.name for actuator in mechanism.actuators]

    def add(what: str, item: int, name: str, values: np.ndarray, bounds, unit: str, bent=None) -> None:
        found.append(margin_of(what, item, name, values, bounds, unit, points, time, bent=bent))

    if np.any(np.isfinite(limits.effort_rate)):
        rate, jumps = _effort_rates(trajectory, time)
        for j, bounds in enumerate(limits.effort_rate):
            if np.any(np.isfinite(bounds)):
                values = np.where(np.isnan(jumps[:, j]), rate[:, j], jumps[:, j])
                add("effort_rate", j, names[j], values, bounds, f"{mechanism.actuators[j].unit}/s")
    lined = [j for j, motor in enumerate(problem.motors) if motor is not None and motor.has_line]
    powered = [j for j, bounds in enumerate(limits.power) if np.any(np.isfinite(bounds))]
    if lined or powered:
        w = actuator_speeds(problem, q, v)
        for j in lined:
            motor = problem.motors[j]
            add("motor", j, names[j], u[:, j] / motor.stall_effort + w[:, j] / motor.no_load_speed, (-1.0, 1.0), "")
        for j in powered:
            add("power", j, names[j], u[:, j] * w[:, j], limits.power[j], "W")
    if limits.limited_closures:
        forces = closure_forces(problem, q, v, a, u)
        for c in limits.limited_closures:
            bounds = (-np.inf, limits.closure_force[c])
            add("closure_force", c, mechanism.closure_names[c], forces[:, c], bounds, "N")
    servos = [j for j, actuator in enumerate(mechanism.actuators) if actuator.limits_control]
    if servos:
        w, length = actuator_speeds(problem, q, v), sampled(mechanism.dynamics.actuator_length, q)[:, :, 0]
        for j in servos:
            actuator = mechanism.actuators[j]
            b = actuator.biases
            ctrl = (u[:, j] - b[0] - b[1] * length[:, j] - b[2] * w[:, j]) / actuator.gain
            bounds = (actuator.control_lower, actuator.control_upper)
            ranged, bent = _ranged(actuator, ctrl, u[:, j], len(points))
            add("control", j, names[j], ranged, bounds, "", bent=bent)
    if mechanism.tendons:
        lengths = sampled(mechanism.dynamics.tendon_length, q)[:, :, 0]
        for item, (one, values) in enumerate(zip(mechanism.tendons, lengths.T, strict=True)):
            found.append(margin_of("tendon", item, one.name, values, (one.low, one.high), one.unit, points, time, one.span))
    corners = problem.robust.corners
    if corners:
        joints = tuple(joint.name for joint in mechanism.joints)
        efforts = corner_efforts_along(mechanism, corners, q, v, a, u)
        for item, corner in enumerate(corners):
            for j, bounds in enumerate(problem.robust.room * limits.effort):
                where = f"{names[j]} with {corner.said(joints)}"
                add("robust", item * mechanism.n_u + j, where, efforts[:, item, j], bounds, mechanism.actuators[j].unit)
    if limits.singular_margin > 0:
        for block, ratios in enumerate(block_ratios(problem, q).T):
            add("singular_margin", block, mechanism.name, ratios, (limits.singular_margin, np.inf), "")
    return tuple(found)


def _ranged(actuator: Actuator, ctrl: np.ndarray, u: np.ndarray, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what a servo's ctrlrange bounds (n,), and where (n,) all of its range is beyond a clamp of its force."""
    ranged = ranged_control(actuator, ctrl, u, actuator.gain, np.maximum)
    bent = ranged != ctrl
    beside = np.repeat(bent.reshape(-1, n_points).any(axis=1), n_points)
    within = np.clip(ranged, actuator.control_lower, actuator.control_upper)
    clamp = np.abs([end for end in (actuator.lower, actuator.upper) if np.isfinite(end)]).max(initial=0.0)
    near = np.abs(ranged - within) * abs(actuator.gain) <= _AT_CLAMP * clamp
    return np.where(beside & near, within, ranged), bent


def block_ratios(problem: PlanningProblem, q: np.ndarray) -> np.ndarray:
    """Return the determinants of J_z's blocks (n, n_blocks), of loops that close together, as shares of those at home."""
    block = problem.mechanism.dynamics.block_singularity
    return sampled(block, q)[:, :, 0] / np.array(block(problem.mechanism.home)).ravel()


def singularity_ratios(problem: PlanningProblem, q: np.ndarray) -> np.ndarray:
    """Return the least of J_z's blocks' determinants at poses q (n, n_q), as shares of home's: 0 at a singular pose.

    1 without loops.
    """
    if len(problem.mechanism.dependent) == 0:
        return np.ones(len(q))
    return block_ratios(problem, q).min(axis=1)


def _effort_rates(trajectory: Trajectory, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return u' (n, n_u) within intervals, and next to a jump in effort an infinite rate of its sign, NaN elsewhere."""
    degree = trajectory.effort.shape[0] - 1
    widths = np.diff(trajectory.breaks_s)
    index = np.clip(np.searchsorted(trajectory.breaks_s, time, side="right") - 1, 0, len(widths) - 1)
    tau = (time - trajectory.breaks_s[index]) / widths[index]
    slope = degree * np.diff(trajectory.effort, axis=0) / widths[:, None]
    basis = bernstein_matrix(max(degree - 1, 0), tau) if degree else np.zeros((len(time), 0))
    rate = np.einsum("tp,ptu->tu", basis, slope[:, index]) if degree else np.zeros((len(time), trajectory.n_u))
    jumps = np.full((len(time), trajectory.n_u), np.nan)
    step = trajectory.effort[0, 1:] - trajectory.effort[-1, :-1]
    size = 1e-7 * max(float(np.abs(trajectory.effort).max()), np.finfo(float).tiny)
    for k, j in zip(*np.nonzero(np.abs(step) > size), strict=True):
        jumps[np.flatnonzero(index == k + 1)[:1], j] = np.inf * np.sign(step[k, j])
    return rate, jumps
