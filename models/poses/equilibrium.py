"""Where freedoms without a drive rest on their springs: what a start or goal means that does not name them.

Of a leg with springs in it a user knows where its motors stand, not by how much its springs give. At rest the drives can
hold everything but what lies in the null space of their effort map R (n_s, n_u); there springs and weight balance:

    N^T tau(s, 0, 0) = 0,   N^T R = 0.
"""

from collections.abc import Mapping

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at

# The rest is found where what springs and weight leave over is below this share of the springs' own effort at a radian.
_BALANCED = 1e-9
# A spring's effort on a coordinate below this share of the stiffest one's is rounding.
_SPRING = 1e-12


def sprung_freedoms(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the columns of coordinates that no actuator is on, that are not passive, and that springs act on at home."""
    stiffness = _stiffness(mechanism).diagonal()
    driven = {actuator.joint for actuator in mechanism.actuators}
    return tuple(
        column
        for column, index in enumerate(mechanism.independent.tolist())
        if index not in driven
        and index not in mechanism.passive_dofs
        and stiffness[column] > _SPRING * stiffness.max(initial=0.0)
    )


def resting(mechanism: Mechanism, named: Mapping[int, float], unnamed: tuple[int, ...]) -> np.ndarray | None:
    """Return positions s (n_s,) [rad or m] at which freedoms rest on their springs; None where no such rest is found.

    Args:
        mechanism: whose springs they are.
        named: positions by column of s; what is neither named nor unnamed stands at home.
        unnamed: columns to be found, from home.
    """
    import scipy

    base = mechanism.home[mechanism.independent].copy()
    for column, value in named.items():
        base[column] = value
    columns, still, near = list(unnamed), np.zeros(mechanism.dof), np.array(mechanism.home)

    def closed(x: np.ndarray) -> np.ndarray:
        s = base.copy()
        s[columns] = x
        return close_at(mechanism, s, near)

    def left_over(x: np.ndarray) -> np.ndarray:
        pose = closed(x)
        tau = np.array(mechanism.dynamics.inverse_dynamics(pose, still, still)).ravel()
        beyond = scipy.linalg.null_space(np.array(mechanism.dynamics.effort_map(pose)).T)
        return beyond @ (beyond.T @ tau)  # in the coordinates' own axes: a null space's basis may turn from pose to pose

    try:
        found = scipy.optimize.least_squares(left_over, base[columns], x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        rest = left_over(found.x)
    except AssemblyError:
        return None
    if np.abs(rest).max(initial=0.0) > _BALANCED * _stiffness(mechanism).diagonal().max(initial=0.0):
        return None
    s = base.copy()
    s[columns] = found.x
    return s


def _stiffness(mechanism: Mechanism) -> np.ndarray:
    """Return the springs' stiffness along the coordinates at home (n_s, n_s), by differences of what they do."""
    home, still = mechanism.home, np.zeros(mechanism.n_q)
    velocity_map = np.array(mechanism.dynamics.velocity_map(home))
    step = 1e-6
    springs = [
        (
            np.array(mechanism.dynamics.passive(home + step * column, still)).ravel()
            - np.array(mechanism.dynamics.passive(home - step * column, still)).ravel()
        )
        / (2 * step)
        for column in velocity_map.T
    ]
    return -velocity_map.T @ np.array(springs).T
