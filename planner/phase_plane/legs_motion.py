"""The motion along the phase plane's legs as polynomials, by collocation of one interval at a time without a solver.

Under a limit on power, the speed converges within a thousandth of the motion to the speed at which the power balances the
weight. Backward in time from the goal, the speed converges likewise. A program over the whole motion is therefore
ill-conditioned. Each leg is collocated in the direction in which its errors decrease: forward in time from the start, and
backward from the goal.
"""

import itertools

import numpy as np

from linkplan.models.deadline import Deadline
from linkplan.planner.limits.kinds import narrowed
from linkplan.planner.phase_plane.power_legs import Leg, power_legs
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import bernstein_matrix
from linkplan.planner.transcription.schemes import scheme

# The share of limits on effort, power and lines that is left for the polynomials between their nodes, and the share by which
# they may differ from the effort and from its acceleration.
_LIMIT_RESERVE, _POLYNOMIAL_TOLERANCE = 1e-8, 3e-9
LEGS_SCHEME = "radau-7"
# Shares of an interval at which it is checked.
_CHECKED_AT = np.linspace(1 / 32, 1.0, 12)  # a leg may begin at a singular point of its limit, where its law is 0 / 0


def legs_motion(problem: Problem, start_pose: np.ndarray) -> Trajectory | None:
    """Return the quickest reach along its limits that turns back only at required waypoints; None if there is none.

    No motion without additional turns is faster than the legs at any position, so this motion is the quickest of them.

    Args:
        problem: one with limits on all efforts. Limits on power, line, pin force and speed are considered, others are not.
        start_pose: the closed pose (n_q,) at the start.
    """
    found = power_legs(narrowed(problem, _LIMIT_RESERVE), start_pose)
    if found is None:
        return None
    legs, boundaries = found
    pieces = [_pieces(leg, boundaries, problem.solver.deadline) for leg in legs]
    if any(piece is None for piece in pieces):
        return None
    breaks, *parts = ([one for piece in pieces for one in piece[k]] for k in range(4))
    ends = np.append(breaks, legs[-1].later + legs[-1].end)
    position, velocity, effort = (np.stack(part, axis=1) for part in parts)
    return Trajectory(
        breaks_s=ends,
        position=position[:, :, None],
        velocity=velocity[:, :, None],
        effort=effort,
        start_pose=start_pose,
        periodic=False,
    )


def _pieces(leg: Leg, boundaries: np.ndarray, deadline: Deadline) -> tuple[list, list, list, list] | None:
    """Return the start times [s] of a leg's intervals and their coefficients; None if the intervals become too short.

    Each interval has coefficients of position (m + 2,), velocity (m + 1,) and effort (m, n_u).
    """
    arcs = leg.arcs()
    until = np.array([end - leg.later for end, _ in arcs])
    passed = boundaries - leg.later
    ends = np.concatenate([[leg.begin], until[:-1], passed[(passed > leg.begin) & (passed < leg.end)], [leg.end]])
    ends = np.unique(ends) if leg.towards else np.unique(ends)[::-1]
    at, found = leg.state(ends[0]), []
    for begin, end in itertools.pairwise(ends):
        held = np.array(arcs[int(np.searchsorted(until[:-1], 0.5 * (begin + end)))][1])
        longest = 0.01 * boundaries[-1]  # over a hundredth of it an unstable motion can be integrated
        t, h = begin, 0.25 * (end - begin)
        while t != end:
            deadline.require_time()
            h = np.copysign(min(abs(h), longest), h)
            h = end - t if abs(h) > 0.9 * abs(end - t) else h
            piece = _collocated(leg, held, t, h, at)
            if piece is None:
                h *= 0.5
                if abs(h) < 1e-12 * abs(end - begin):  # of its arc: rounding
                    return None
                continue
            *coefficients, at = piece
            first = leg.later + (t if leg.towards else t + h)
            found.append((first, *(c if leg.towards else c[::-1] for c in coefficients)))
            t, h = (end if h == end - t else t + h), 2.0 * h
    breaks, *parts = zip(*(found if leg.towards else found[::-1]), strict=True)
    position, velocity, effort = (list(part) for part in parts)
    return list(breaks), position, velocity, effort


def _collocated(leg: Leg, held: np.ndarray, t: float, h: float, at: np.ndarray):
    """Return an interval's coefficients and the state (2,) at its end; None if they are not close to the leg's dynamics.

    Args:
        leg: the leg.
        held: the limits (n_u,) at which the actuators are held on the interval.
        t: the start of the interval, in the leg's time [s].
        h: the width of the interval [s], negative backward in time.
        at: position and speed (2,) at t.
    """
    known = scheme(LEGS_SCHEME)
    nodes = known.nodes

    def law(s: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return leg.field.along(s, v, held)

    def states(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return at[0] + h * nodes * at[1] + h**2 * known.position @ a, at[1] + h * known.velocity @ a

    inside = np.clip(t + h * nodes, leg.begin, leg.end)
    guessed = leg.state(inside)
    a = law(*guessed)[1]
    size = np.abs(guessed).max(axis=1)
    with np.errstate(all="ignore"):  # over an interval that is too long Newton's steps may lead anywhere
        for _ in range(12):  # Newton steps; an interval that needs more is halved
            s, v = states(a)
            asked = law(s, v)[1]
            nudge = 1e-7 * np.maximum(np.abs(v), size[1])  # for slopes by differences
            by_speed = (law(s, v + nudge)[1] - asked) / nudge
            # Newton's steps ignore d(law)/d(position), which is negligible on short intervals.
            slope = np.eye(len(nodes)) - h * by_speed[:, None] * known.velocity
            step = np.linalg.solve(slope, asked - a)
            a = a + step
            if np.abs(h * step).max() <= 1e-13 * size[1]:  # rounding
                break
        else:
            return None
    s, v = states(a)
    effort = law(s, v)[0]
    m = len(nodes)
    position = at[0] + h * np.arange(m + 2) / (m + 1) * at[1] + h**2 * known.position_coefficients @ a
    velocity = at[1] + h * known.velocity_coefficients @ a
    efforts = np.linalg.solve(known.effort_at, effort)
    s, v, u, slope = (
        bernstein_matrix(len(c) - 1, _CHECKED_AT) @ c
        for c in (position, velocity, efforts, np.linalg.solve(known.effort_at, a))
    )
    asked, pushed = law(s, v)
    size = leg.field.limit_sizes(s, held, asked)
    values = leg.field.curves(s)
    strength = np.abs(values[:, 4:] * size).sum(axis=1) / values[:, 0]
    if np.any(np.abs(u - asked) > _POLYNOMIAL_TOLERANCE * size) or np.any(
        np.abs(slope - pushed) > _POLYNOMIAL_TOLERANCE * strength
    ):
        return None
    return position, velocity, efforts, np.array([position[-1], velocity[-1]])
