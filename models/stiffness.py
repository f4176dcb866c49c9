"""The stiffness of MuJoCo's equality constraints and dry friction: on request the stiffest that the timestep admits."""

import mujoco
import numpy as np

from linkplan.models.errors import ModelError
from linkplan.models.names import nearest

# The only legal value of `mechanism.solref`.
STIFF = "stiff"
# The impedance of the built-in models, close to MuJoCo's maximum of 0.9999, as MJCF text and as numbers (MuJoCo, "Solver
# parameters": d_0, d_width, width [m], midpoint, power).
STIFF_IMPEDANCE = "0.999 0.999 0.001"
STIFF_SOLIMP = (0.999, 0.999, 0.001, 0.5, 2.0)


def stiff_time_constant_s(model: mujoco.MjModel) -> float:
    """Return the least time constant [s] that MuJoCo admits for constraints, two timesteps."""
    return 2.0 * float(model.opt.timestep)


def set_softness(model: mujoco.MjModel, asked: object) -> None:
    """Set the stiffest equality constraints and dry friction if `asked` is "stiff"; keep the model's own if it is None.

    Raises:
        ModelError: if `asked` has another value.
    """
    if asked is None:
        return
    if asked != STIFF:
        raise ModelError(
            f'mechanism.solref is "{STIFF}", the stiffest closures that the timestep admits, or is left out, which keeps the'
            f" model's own; got {asked!r}{nearest(str(asked), [STIFF])}"
        )
    model.eq_solref[:] = stiff_time_constant_s(model), 1.0
    model.eq_solimp[:] = np.array(STIFF_SOLIMP)
    make_dry(model, model.dof_frictionloss > 0)
    dry = model.tendon_frictionloss > 0
    model.tendon_solref_fri[dry] = stiff_time_constant_s(model), 1.0
    model.tendon_solimp_fri[dry] = np.array(STIFF_SOLIMP)


def make_dry(model: mujoco.MjModel, dofs: np.ndarray) -> None:
    """Set the stiffest dry friction for the degrees of freedom in the mask `dofs` (nv,).

    MuJoCo's dry friction is viscous below a speed (`models.tree.friction.viscous_below`). With MuJoCo's defaults this speed
    is 9 rad/s for 0.4 N.m at the knee's coupler, whose inertia is small: the joint would creep where it should stick.
    """
    model.dof_solref[dofs] = stiff_time_constant_s(model), 1.0
    model.dof_solimp[dofs] = np.array(STIFF_SOLIMP)
