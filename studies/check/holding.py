"""Poses that the actuators hold with an effort between their limits, as a linear feedback loop about a pose requires."""

import numpy as np

from linkplan.models.actuation.distribution import HOLDING_TOLERANCE, LEAST_PEAK, distribute
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import demanded, distributed
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import spring_equilibrium, sprung_freedoms
from linkplan.models.tree.joints import where
from linkplan.planner.problem.limits import within_reserve
from linkplan.studies.check.drives import motors_hint

# The reserve of an actuator's effort range at a pose of a feedback loop, so that the loop can respond.
EFFORT_RESERVE = 0.1


def require_actuated(mechanism: Mechanism) -> None:
    """Refuse a mechanism without an actuator."""
    if mechanism.n_u == 0:
        lack = f"a feedback loop needs an actuator; '{mechanism.name}' has no motor on a hinge or slide"
        raise LinkplanError(f"{lack}: {motors_hint(mechanism)}")


def held_pose(
    mechanism: Mechanism, position: np.ndarray, effort_limit: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the closed pose (n_q,) at independent positions (n_s,) [rad or m], and the effort (n_u,) that holds it.

    If no effort holds coordinates on springs without an actuator in the given positions, they take their equilibrium
    positions.

    Raises:
        LinkplanError: if the mechanism has no actuator, its loops do not close, or no effort within the limits (n_u, 2)
            holds the pose.
    """
    require_actuated(mechanism)
    limit = mechanism.effort_limit if effort_limit is None else effort_limit
    position = np.atleast_1d(position)
    pose, hold = _held(mechanism, position, limit)
    free = sprung_freedoms(mechanism)
    if hold is None and free:
        named = {k: float(x) for k, x in enumerate(position) if k not in free}
        rest = spring_equilibrium(mechanism, named, free)
        pose, hold = (pose, None) if rest is None else _held(mechanism, rest, limit)
    channels = list(mechanism.channels)
    at = where([mechanism.independent_joints[k] for k in channels], pose[mechanism.independent][channels])
    if hold is None:
        raise LinkplanError(f"no effort holds '{mechanism.name}' at {at}")
    for actuator, effort, (low, high) in zip(mechanism.actuators, hold, limit, strict=True):
        # An actuator at a limit responds in one direction only, so the loop is not linear there.
        room = HOLDING_TOLERANCE * max(abs(low), abs(high)) if np.isfinite([low, high]).all() else 0.0
        if not low + room < effort < high - room:
            shown = effort if abs(effort) > room else 0.0
            raise LinkplanError(
                f"'{mechanism.name}' cannot be held at {at}: {actuator.name} would need {shown:.4g}"
                f" {actuator.unit}, its limits are {low:g} to {high:g}, and a feedback loop needs effort to both sides of"
                " the holding effort"
            )
    return pose, hold


def _held(mechanism: Mechanism, position: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the closed pose (n_q,) at independent positions (n_s,), and the effort (n_u,) that holds it, or None.

    More actuators than freedoms hold it with a reserve to their limits, if they can, else with the largest share of their
    ranges that all of them can keep free.
    """
    pose, still = close_at(mechanism, position), np.zeros((1, mechanism.dof))
    tau, maps = demanded(mechanism, pose[None], still, still)
    inside = within_reserve(limit, EFFORT_RESERVE)
    (hold,) = distributed(mechanism, tau, maps, inside)
    if np.any((hold < inside[:, 0]) | (hold > inside[:, 1])):
        middle = np.where(np.isfinite(limit).all(axis=1), limit.mean(axis=1), 0.0)
        left = tau - maps[0] @ middle
        hold = middle + distribute(left, maps, limit - middle[:, None], rule=LEAST_PEAK)[0]
    missed = np.abs(tau[0] - maps[0] @ hold).max()
    holds = np.all(np.isfinite(hold)) and missed <= HOLDING_TOLERANCE * max(1.0, np.abs(hold).max())
    return pose, hold if holds else None


def why_no_loop(mechanism: Mechanism, positions: np.ndarray, effort_limit: np.ndarray) -> str | None:
    """Return the reason why gains can be found at none of the positions (n, n_s), or None if they can at one."""
    why = None
    for position in positions:
        try:
            held_pose(mechanism, position, effort_limit)
        except LinkplanError as error:
            why = why or str(error)
        else:
            return None
    return why
