"""The kinds of limits (the classes in this folder's files), the limits of a problem, and functions on one kind."""

import functools
import importlib
import pkgutil
from collections.abc import Iterator

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import needed_effort
from linkplan.planner import limits
from linkplan.planner.limits.actuators import further_control_claims
from linkplan.planner.limits.bounds import Affine, EffortBounds
from linkplan.planner.limits.efforts import lacking_corner_claims
from linkplan.planner.limits.limit import Limit, Margin, WhichJoints, clipped, limit_margin, with_limits
from linkplan.planner.limits.samples import Poses, Samples, samples_of
from linkplan.planner.problem.instant import unit_scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory

# The order of their rows in a program, by their keys; other kinds follow. A diagnosis removes limits in the same order, with
# the first two last, to find the one that forbids a motion.
_ORDER = (
    *(
        "effort",
        "position",
        "robust",
        "jerk",
        "site_jerk",
        "site_acceleration",
        "acceleration",
        "speed",
        "site_speed",
        "power",
    ),
    *("closure_force", "pin_force", "motor", "control", "effort_rate", "singular_margin"),
    *("tendon", "ball", "site", "path", "body"),
)


def _kinds() -> Iterator[type[Limit]]:
    """Yield the public classes of limits in this folder's files."""
    for file in pkgutil.iter_modules(limits.__path__, f"{limits.__name__}."):
        if file.name != __name__:
            for value in vars(importlib.import_module(file.name)).values():
                own = isinstance(value, type) and issubclass(value, Limit) and value.__module__ == file.name
                if own and value is not Limit and not value.__name__.startswith("_"):
                    yield value


KINDS: tuple[type[Limit], ...] = tuple(
    sorted(_kinds(), key=lambda kind: _ORDER.index(kind.key) if kind.key in _ORDER else len(_ORDER))
)
# Between nodes a motion slightly exceeds its values at the nodes. A limit that must permit the motion is widened by this
# factor.
BETWEEN_NODES_FACTOR = 1.001
# Claims of a proof in addition to the limits of the program.
FURTHER_CLAIMS = (further_control_claims, lacking_corner_claims)


def limits_of(problem: Problem, *, enclosed: bool = False, position_rows: WhichJoints = False) -> tuple[Limit, ...]:
    """Return a problem's limits; the arguments are those of `Limit.of`."""
    asked = []
    for kind in KINDS:
        field = getattr(problem.limits, kind.key, getattr(problem, kind.key, True))  # True if neither has it
        if np.isfinite(field).any() if isinstance(field, np.ndarray) else field:
            asked.append(kind)
    return tuple(limit for kind in asked for limit in kind.of(problem, enclosed=enclosed, position_rows=position_rows))


def structure_of(problem: Problem) -> tuple:
    """Return the structure of a problem's limits: its limits, and which of their bounds are finite."""
    ones = unit_scales(problem.mechanism)
    return tuple((type(limit), limit, *np.isfinite(limit.bounds(problem, ones))) for limit in limits_of(problem))


def relaxed_kinds(problem: Problem, *, at_last: bool = False) -> list[type[Limit]]:
    """Return, in order, the kinds of limits that a diagnosis removes: all but efforts and ranges, or ranges `at_last`."""
    return [kind for kind in (KINDS[1:2] if at_last else KINDS[2:]) if kind.of(problem)]


def all_effort_bounds(problem: Problem) -> tuple[EffortBounds, ...]:
    """Return the bounds on efforts of all kinds of limits; those of constant efforts are the first."""
    return tuple(one for kind in KINDS if (one := kind.effort_bounds(problem)) is not None)


def effort_bounds(problem: Problem, speeds: np.ndarray | None = None) -> np.ndarray:
    """Return the least and the largest effort (..., n_u, 2) that limits permit, except those that depend on lengths.

    Args:
        problem: with the limits.
        speeds: of the actuators (..., n_u) [rad/s or m/s]; without them the bounds are those at any speed, (n_u, 2).
    """
    asked = [one for one in all_effort_bounds(problem) if (one.constant if speeds is None else not one.of_length)]
    low, high = zip(*(one.at(speeds, None) for one in asked), strict=True)
    ends = functools.reduce(np.maximum, low), functools.reduce(np.minimum, high)
    return np.stack([np.broadcast_to(end, np.shape(end if speeds is None else speeds)) for end in ends], axis=-1)


def are_efforts_bounded(problem: Problem) -> bool:
    """True if limits bound all efforts from both sides, whatever the speeds."""
    return bool(np.all(np.isfinite(effort_bounds(problem))))


def needed_efforts(
    problem: Problem, q: np.ndarray, v: np.ndarray, a: np.ndarray, time_s: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the efforts (n, n_u) for a motion and what they miss, by `needed_effort` with a problem's limits."""
    return needed_effort(problem.mechanism, q, v, a, time_s, limit=effort_bounds(problem))


def affine_limits(problem: Problem, *, of_speed: bool) -> list[Affine]:
    """Return the limits on affine quantities: those proportional to the speed if `of_speed`, else the others."""
    stated = [limit.affine(problem) for limit in limits_of(problem)]
    return [one for one in stated if one is not None and one.of_speed == of_speed]


def kept_at(problem: Problem, q: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the poses q (n, n_q) that satisfy the limits on poses that the phase plane considers."""
    at, kept = Poses(problem=problem, q=q), np.ones(len(q), dtype=bool)
    for limit in limits_of(problem):
        if limit.facts.of_position and limit.facts.in_phase_plane:
            measured = limit.measured(at)
            kept &= (measured.values >= measured.bounds[0]) & (measured.values <= measured.bounds[1])
    return kept


def narrowed(problem: Problem, share: float) -> Problem:
    """Return a problem in which the limits along which phase plane motions move are narrowed by a share of their bounds."""
    facts = {type(limit): limit.facts for limit in limits_of(problem)}
    for kind, of in facts.items():
        rows = getattr(problem.limits, kind.key, None)
        if not (of.followed_with or (of.in_phase_plane and not of.of_position)):
            continue
        if isinstance(rows, np.ndarray) and rows.ndim > 1:
            size = np.where(np.isfinite(rows), np.abs(rows), 0.0)
            problem = with_limits(problem, **{kind.key: rows + share * size * np.array([1.0, -1.0])})
        else:
            problem = kind.relaxed(problem, 1.0 - share)
    return problem


def beyond_bounds(problem: Problem, effort: np.ndarray) -> np.ndarray:
    """Return by how much efforts (..., n_u) are beyond their bounds at any speed; negative between them."""
    low, high = effort_bounds(problem).T
    return np.maximum(effort - high, low - effort)


def margins_along(samples: Samples) -> tuple[Margin, ...]:
    """Return the margins of all limits along a motion."""
    return tuple(limit_margin(limit, samples) for limit in limits_of(samples.problem))


def without(kind: type[Limit], problem: Problem) -> Problem:
    """Return a problem without its limits of a kind."""
    return kind.relaxed(problem, np.inf)


def overrun_margins(kind: type[Limit], problem: Problem, motion: Trajectory) -> list[Margin]:
    """Return the overrun margins of one kind along a motion."""
    samples = samples_of(problem, motion)
    found = [limit_margin(limit, samples) for limit in kind.of(problem)]
    return [margin for margin in found if not margin.kept]


def factor_of(kind: type[Limit], problem: Problem, motion: Trajectory) -> float | None:
    """Return the factor on a kind's limits with which a motion satisfies them; None if it already does, or never can."""
    over = [margin for margin in overrun_margins(kind, problem, motion) if np.isfinite(margin.value)]
    if not over:
        return None
    if over[0].of.facts.by_size:
        return 1.0 + BETWEEN_NODES_FACTOR * max(-margin.share for margin in over)
    ratios = [margin.value / margin.limit for margin in over if margin.limit]
    if not ratios:
        return None
    # A lower bound above zero, such as one on a distance, is relaxed by a factor below one.
    fall = min(ratios) if all(not margin.upper and margin.limit > 0 for margin in over) else None
    return fall / BETWEEN_NODES_FACTOR if fall is not None else BETWEEN_NODES_FACTOR * max(ratios)


def violation(kind: type[Limit], problem: Problem, motion: Trajectory, factor: float = np.inf) -> Margin | None:
    """Return the worst overrun of a kind's limits; None if a motion satisfies them.

    At its nodes the motion satisfies the limits relaxed by a factor; between them, overruns of these are the mesh's error.
    """
    try:
        over = overrun_margins(kind, problem, motion)
    except AssemblyError:
        return None
    if np.isfinite(factor):
        relaxed = kind.relaxed(problem, factor)
        samples, every = samples_of(relaxed, motion), zip(kind.of(problem), kind.of(relaxed), strict=True)
        bounds = {limit: wider.measured(samples).bounds for limit, wider in every}
        over = [within for margin in over if not (within := clipped(margin, bounds[margin.of])).kept]
    return max(over, key=lambda m: m.overrun.max(), default=None)


def tightened_in(problem: Problem, margin: Margin, factor: float, least: float) -> Problem:
    """Return a problem in which one joint's limit is tightened by `factor` times its overrun.

    If the limit is not satisfied, it is tightened by at least `least` [rad or m, per second for speeds].
    """
    rows = getattr(problem.limits, margin.of.key).copy()
    over = max(0.0, -margin.left) / problem.mechanism.joints[margin.item].shown(1.0)
    rows[margin.item] += max(factor * over, 0.0 if margin.kept else least) * np.array([1.0, -1.0])
    return with_limits(problem, **{margin.of.key: rows})
