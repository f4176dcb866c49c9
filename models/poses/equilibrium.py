"""Static equilibrium of undriven coordinates on their springs, for a start or goal that does not name these coordinates.

In a leg with springs, a user states the positions of the motors but not the deflections of the springs. At rest the
actuators can balance every generalised effort except those in the null space N^T of their effort map R (n_s, n_u). In that
null space springs and gravity balance:

    N^T tau(s, 0, 0) = 0,   N^T R = 0.
"""

import functools
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from linkplan.models.closure.initial_assembly import home_text
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.tree.joints import Joint


@functools.lru_cache(maxsize=16)
def sprung_freedoms(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the independent coordinates (columns) with springs at home that are neither driven nor passive."""
    stiffness = _stiffness(mechanism).diagonal()
    driven = {actuator.joint for actuator in mechanism.actuators}
    return tuple(
        column
        for column, index in enumerate(mechanism.independent.tolist())
        if index not in driven
        and index not in mechanism.passive_dofs
        and stiffness[column] > 1e-12 * stiffness.max(initial=0.0)  # below this it is zero to rounding
    )


def spring_equilibrium(mechanism: Mechanism, named: Mapping[int, float], unnamed: tuple[int, ...]) -> np.ndarray | None:
    """Return positions s (n_s,) [rad or m] at static equilibrium on the springs, or None if none is found.

    Args:
        mechanism: the assembled mechanism.
        named: prescribed positions by column of s; columns that are in neither argument stay at home.
        unnamed: columns to solve for, starting from home.
    """
    import scipy

    base = mechanism.home[mechanism.independent].copy()
    for column, value in named.items():
        base[column] = value
    columns, still, near = list(unnamed), np.zeros(mechanism.dof), np.array(mechanism.home)
    kept = mechanism.actuated  # not passive: a rod's small weight about its axis moves nothing else
    slopes = slopes_at_rest(mechanism)

    def closed(x: np.ndarray) -> np.ndarray:
        s = base.copy()
        s[columns] += x
        return close_at(mechanism, s, near)

    def efforts(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        tau = np.array(mechanism.dynamics.inverse_dynamics(pose, still, still)).ravel()[kept]
        arms = np.array(mechanism.dynamics.effort_map(pose))[kept]
        return tau, arms, scipy.linalg.null_space(arms.T)

    def unbalanced(x: np.ndarray) -> np.ndarray:
        tau, _, null = efforts(closed(x))
        return null @ (null.T @ tau)  # independent of the null space's basis, which may jump from pose to pose

    def slope(x: np.ndarray) -> np.ndarray:
        """Return d(P tau) of P = N N^T by Kaufman (BIT 15, 1975): P (dtau - dR u) at the held effort u = R^+ tau.

        The rest of the derivative has the factor P tau, which vanishes at an equilibrium.
        """
        pose = closed(x)
        tau, arms, null = efforts(pose)
        unheld = np.array(slopes(pose, np.linalg.pinv(arms) @ tau))[kept]
        return null @ (null.T @ unheld @ np.array(mechanism.dynamics.velocity_map(pose))[:, columns])

    # On the way to an equilibrium each step reduces the squared effort by more than 1e-10 of it. Smaller reductions lead,
    # over thousands of steps, to a least effort that is not zero. The unknowns are deflections from the first pose, so they
    # start at zero. From other values, scipy's first step would be as long as these values.
    try:
        found = scipy.optimize.least_squares(
            unbalanced, np.zeros(len(columns)), slope, x_scale="jac", xtol=1e-15, ftol=1e-10, gtol=1e-15
        )
        rest = unbalanced(found.x)
    except AssemblyError:
        return None
    one_radian = _stiffness(mechanism).diagonal().max(initial=0.0)  # the stiffest spring's effort
    if np.abs(rest).max(initial=0.0) > ROUNDING_SHARE * one_radian:
        return None
    s = base.copy()
    s[columns] += found.x
    return s


@functools.lru_cache(maxsize=16)
def slopes_at_rest(mechanism: Mechanism) -> ca.Function:
    """Return q, u -> the derivative (n_s, n_q) of tau(q, 0, 0) - R u by q at constant u."""
    still, q, u = ca.SX.zeros(mechanism.dof), ca.SX.sym("q", mechanism.n_q), ca.SX.sym("u", mechanism.n_u)
    return ca.Function("slopes_at_rest", [q, u], [ca.jacobian(mechanism.dynamics.residual(q, still, still, u), q)])


def rests_on_stops(mechanism: Mechanism, named: Mapping[int, float], unnamed: tuple[int, ...]) -> dict[int, float]:
    """Return the ends of ranges [rad or m] by column onto which springs and weight press unnamed coordinates at rest.

    The coordinate whose equilibrium lies farthest beyond its range is held at the range's end, and the equilibrium of the
    others is found again. The arguments are those of `spring_equilibrium`.
    """
    held: dict[int, float] = {}
    joints, limited = mechanism.independent_joints, []
    for column in unnamed:
        limited += [column] if np.isfinite([joints[column].lower, joints[column].upper]).any() else []
    while limited:
        s = spring_equilibrium(mechanism, {**named, **held}, tuple(c for c in unnamed if c not in held))
        if s is None:
            break
        ends = {c: float(np.clip(s[c], joints[c].lower, joints[c].upper)) for c in limited}
        column = max(limited, key=lambda c: abs(s[c] - ends[c]))
        if abs(s[column] - ends[column]) < 1e-8:  # rounding of the equilibrium [rad or m]
            break
        held[column] = ends[column]
        limited.remove(column)
    return held


def stop_sentence(stops: Sequence[tuple[Joint, float]], when: str) -> str:
    """Return the sentence on joints that weight and springs press onto their stops [rad or m], with the remedy."""
    names = ", ".join(f"{joint.name} ({joint.text(x, 4)} {joint.unit})" for joint, x in stops)
    return (
        f"{when} weight and springs press {names} onto {'its stop' if len(stops) == 1 else 'their stops'}. No actuator can"
        f" counter this, and plans contain no stop forces: {lock_words(stops)} locks them there, as linkplan.new does"
    )


def lock_words(places: Sequence[tuple[Joint, float]], locked: Mapping[str, float] | None = None) -> str:
    """Return the line of a problem file that locks joints at positions [rad or m], and those `locked` already [deg or m]."""
    lock = {**(locked or {}), **{joint.name: round(joint.shown(x), 6) + 0.0 for joint, x in places}}
    return f"mechanism.{home_text({'lock': lock})}"


@functools.lru_cache(maxsize=16)
def _stiffness(mechanism: Mechanism) -> np.ndarray:
    """Return the springs' stiffness matrix (n_s, n_s) at home."""
    still, gamma = np.zeros(mechanism.n_q), np.array(mechanism.dynamics.velocity_map(mechanism.home))
    by_q = np.array(mechanism.dynamics.passive.jacobian()(mechanism.home, still, still)[0])
    return -gamma.T @ by_q @ gamma
