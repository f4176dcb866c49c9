"""Efforts and forces that every motion needs at the poses that it passes, whatever its accelerations and speeds are there.

At a pose the efforts u satisfy B u = tau_0 + M a + d v + c w, for the accelerations a, the speed v along the only way and
its square w. A force in a pin or closure is F = F_0 + F_u u + F_a a + F_v v + F_w w there. `distribute` finds such u, a, v
and w with the least violation of the limits on efforts, or with the least force within them.
"""

import contextlib
import functools
from collections.abc import Callable, Iterator

import numpy as np

from linkplan.models.actuation.distribution import actuator_sizes, distribute, missed_rounding
from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.limits.bounds import Affine
from linkplan.planner.limits.kinds import are_efforts_bounded, effort_bounds, limits_of
from linkplan.planner.plan.verdict import Overrun, Verdict, infeasible
from linkplan.planner.problem.problem import Problem

# Every so many poses of the only way are checked.
_POSES_APART = 25
# The weight of efforts, accelerations and speeds beside violations of limits and forces, all as shares of their sizes: its
# square is the error of a least force. A force that exceeds its limit by a smaller share than the second number is allowed.
_WEAK_SHARE, _FORCE_SLACK = 1e-4, 1e-6
# Coefficients of speeds below this share of those of efforts and accelerations are rounding.
_ROUNDING_SHARE = 1e-12


def where_of(problem: Problem, pose: np.ndarray) -> str:
    """Return the phrase on a pose (n_q,) on the only path."""
    (crank,), (driven,) = problem.mechanism.independent_joints, problem.mechanism.independent
    return (
        f"where {crank.name} = {crank.text(float(pose[driven]), 4)} {crank.unit}, between start and goal, where every motion"
        " of one degree of freedom passes"
    )


@functools.lru_cache(maxsize=4)
def only_way(problem: Problem) -> np.ndarray | None:
    """Return poses (n, n_q) that every motion of one degree of freedom passes from start to goal; None for others."""
    mechanism, motion = problem.mechanism, problem.motion
    if mechanism.dof != 1 or motion.start is None or motion.goal is None or motion.goal_is_free:
        return None
    try:
        between = np.linspace(motion.start, motion.goal, 401)
        return follow(mechanism, between, close_at(mechanism, motion.start), problem.solver.deadline)
    except AssemblyError:  # the loops open on the path, which another check reports
        return None


def _expanded(of: Callable[..., np.ndarray], poses: np.ndarray, n_s: int, n_u: int) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the coefficients at poses of a function of q, v, a and u: c (n, n_rows) and C (n, n_rows, n_u + n_s + 2).

    Its values are c + C (u, a, v, w). The third value tells if this is exact: damping has no other powers of the speed.
    """
    n, speeds = len(poses), np.array([0.0, 1.0, 2.0, 3.0])
    many = len(speeds) + n_u + n_s
    v, a, u = np.zeros((many, n_s)), np.zeros((many, n_s)), np.zeros((many, n_u))
    v[: len(speeds), 0] = speeds
    u[len(speeds) : len(speeds) + n_u] = np.eye(n_u)
    a[len(speeds) + n_u :] = np.eye(n_s)
    values = of(np.tile(poses, (many, 1)), *(np.repeat(one, n, axis=0) for one in (v, a, u))).reshape(many, n, -1)
    rest, (once, twice, thrice, *others) = values[0], values[1:] - values[0]
    of_w = 0.5 * twice - once
    of_v = once - of_w
    for one in (of_v, of_w):
        one[np.abs(one) <= _ROUNDING_SHARE * np.abs(others).max()] = 0.0
    exact = np.abs(3 * of_v + 9 * of_w - thrice).max() <= 1e-9 * np.abs(thrice).max(initial=np.abs(rest).max())
    return rest, np.stack([*others, of_v, of_w], axis=2), bool(exact)


def _sizes(limit: np.ndarray, *effects: tuple[np.ndarray, float]) -> np.ndarray:
    """Return the sizes of u, the limits (n_u, 2), and of a, v and w: the least with the effect that counts as large.

    Args:
        limit: on efforts.
        effects: coefficients of u, a, v and w, and the effect in their unit.
    """
    n_u, size = len(limit), np.full(effects[0][0].shape[2] - len(limit), np.inf)
    for columns, large in effects:
        most = np.abs(columns[:, :, n_u:]).max(axis=(0, 1))
        size = np.minimum(size, np.divide(large, most, out=np.full_like(most, np.inf), where=most > 0))
    return np.append(actuator_sizes(limit), np.where(np.isfinite(size), size, 1.0))


def force_beyond(problem: Problem) -> Verdict | None:
    """Return the verdict on a pin or closure whose force exceeds its limit at a pose in every motion, or None."""
    limits = [(limit, one) for limit in limits_of(problem) if (one := limit.affine(problem)) is not None and one.force_of]
    if not limits or problem.motion.kind != "reach" or problem.mechanism.forces is not None:
        return None
    for names, poses, at_rest in _passed(problem):
        found = (_least_force(problem, one, poses, at_rest) for _, one in limits)
        for (limit, one), force in zip(limits, found, strict=True):
            most = float(one.bounds[1])
            k = int(np.argmax(force))
            if force[k] > (1 + _FORCE_SLACK) * most:
                where = names or where_of(problem, poses[k])
                words = (
                    f"{limit.facts.words.format(one.force_of)} would have to be at least {force[k]:.4g} N {where},"
                    f" {force[k] - most:.4g} N beyond its limit of {most:.4g} N"
                )
                over = Overrun(limit=limit.key, name=one.force_of, value=float(force[k]), bound=most, unit="N")
                return infeasible(words, known_by="every motion", overruns=(over,))
    return None


def _passed(problem: Problem) -> Iterator[tuple[str, np.ndarray, bool]]:
    """Yield poses that every motion passes: a phrase, the poses (n, n_q), and whether it rests there."""
    motion = problem.motion
    for name in ("start", "goal"):
        s, speed = getattr(motion, name), getattr(motion, f"{name}_speed")
        if s is not None and not (name == "goal" and motion.goal_is_free) and (speed is None or not np.any(speed)):
            with contextlib.suppress(AssemblyError):  # the search says so
                yield f"at rest at the {name}", close_at(problem.mechanism, s)[None], True
    way = only_way(problem)
    if way is not None and not any(frictions_of(problem.mechanism.model)):
        yield "", way[::_POSES_APART], False


def _least_force(problem: Problem, force: Affine, poses: np.ndarray, at_rest: bool) -> np.ndarray:
    """Return the least force (n,) [N] at poses (n, n_q) within the limits on efforts; 0 where it is not known."""
    mechanism, limit, n = problem.mechanism, effort_bounds(problem), len(poses)
    n_s, n_u, most = mechanism.dof, mechanism.n_u, float(force.bounds[1])
    tau, columns, exact = _expanded(lambda *motion: sampled(mechanism.dynamics.residual, *motion)[:, :, 0], poses, n_s, n_u)
    own, of_force, also = _expanded(force.value, poses, n_s, n_u)
    if not at_rest and not (exact and also):
        return np.zeros(n)
    last = n_u + n_s if at_rest else n_u + n_s + 2
    columns, of_force = columns[:, :, :last], of_force[:, :, :last]
    given = (np.abs(columns[:, :, :n_u]) @ actuator_sizes(limit)).max()
    size = _sizes(limit, (columns, given), (of_force, most + np.abs(own).max())) / _WEAK_SHARE
    free = [[-np.inf, np.inf]] * (n_s + 1) + [[0.0, np.inf]]
    ends = np.vstack([limit, free])[:last] / size[:, None]
    # Unknowns are u, a, v and w in their weak sizes, and F in that of its limit.
    k = own.shape[1]
    rows = np.zeros((n, tau.shape[1] + k, len(size) + k))
    rows[:, : tau.shape[1], : len(size)] = -columns * size
    rows[:, tau.shape[1] :, : len(size)] = -of_force * size
    rows[:, tau.shape[1] :, len(size) :] = most * np.eye(k)
    found = distribute(np.hstack([tau, own]), rows, np.vstack([ends, [[-np.inf, np.inf]] * k]))
    within = np.all(np.abs(found[:, : len(size)] - np.clip(found[:, : len(size)], *ends.T)) <= 1e-9, axis=1)
    return np.where(within, most * np.linalg.norm(found[:, len(size) :], axis=1), 0.0)


def too_weak_on_the_path(problem: Problem) -> Verdict | None:
    """Return the verdict on a pose of a path at which no efforts within their limits keep its site on the path, or None.

    With more equations than freedoms, accelerations and speeds may not suffice. They are efforts of three further actuators
    here, so weak that only motors violate their limits: v and w are at least 0, and 0 at the ends, from where the path leads
    forward in time.
    """
    mechanism, limit, poses = problem.mechanism, effort_bounds(problem), only_way(problem)
    if mechanism.n_equations == mechanism.dof or poses is None or mechanism.forces is not None:
        return None
    if any(frictions_of(mechanism.model)) or not are_efforts_bounded(problem):
        return None
    poses, size, n_u = poses[::_POSES_APART], np.abs(limit).max(axis=1), mechanism.n_u
    ends, residual = [0, -1], mechanism.dynamics.residual
    tau, columns, exact = _expanded(lambda *motion: sampled(residual, *motion)[:, :, 0], poses, 1, n_u)
    if not exact:
        poses, tau, columns = poses[ends], tau[ends], columns[ends]
    maps = -columns
    maps[:, :, n_u:] *= _sizes(limit, (maps, _WEAK_SHARE * (np.abs(maps[:, :, :n_u]) @ size).max()))[n_u:]
    limits = np.tile(np.vstack([limit, [[-np.inf, np.inf], [0, np.inf], [0, np.inf]]]), (len(poses), 1, 1))
    limits[ends, n_u:] = 0.0
    limits[0, n_u, 1], limits[-1, n_u, 0] = np.inf, -np.inf
    effort = distribute(tau, maps, limits)[:, :n_u]
    nearest = np.clip(effort, *limit.T)
    off = np.abs(effort - nearest)
    k, j = np.unravel_index(int(np.argmax(off / size)), off.shape)
    if off[k, j] <= missed_rounding(limit):
        return None
    actuator, share = mechanism.actuators[j], k / (len(poses) - 1)
    where = {0.0: "at rest at the path's beginning", 1.0: "at rest at the path's end"}.get(
        share, f"{share:.0%} along the path"
    )
    words = (
        f"{where}, {actuator.name} on {actuator.target} would"
        f" have to give {effort[k, j]:.4g} {actuator.unit}, {off[k, j]:.4g} {actuator.unit} beyond its limit of"
        f" {nearest[k, j]:.4g} {actuator.unit}, to keep its site on the path"
    )
    value, bound = float(effort[k, j]), float(nearest[k, j])
    over = Overrun(limit="effort", name=actuator.name, value=value, bound=bound, unit=actuator.unit)
    return infeasible(words, known_by="every motion", overruns=(over,))
