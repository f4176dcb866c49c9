"""How stiff MuJoCo's equality constraints are: the stiffest that a model's timestep admits, on request."""

import mujoco
import numpy as np

from linkplan.models.errors import ModelError
from linkplan.models.names import nearest

# The one word that `mechanism.solref` takes.
STIFF = "stiff"
# Impedances next to the largest that MuJoCo admits, 0.9999: what the built-in models have. In MJCF's words, and in numbers
# (MuJoCo, "Solver parameters": d_0, d_width, width [m], midpoint, power).
STIFF_IMPEDANCE = "0.999 0.999 0.001"
STIFF_SOLIMP = (0.999, 0.999, 0.001, 0.5, 2.0)
# The least time constant that MuJoCo admits, in steps.
_STEPS = 2.0


def stiff_time_constant_s(model: mujoco.MjModel) -> float:
    """Return the least time constant [s] that a model's timestep admits for its constraints."""
    return _STEPS * float(model.opt.timestep)


def set_softness(model: mujoco.MjModel, asked: object) -> None:
    """Give a model's equality constraints and its dry friction the softness asked for: their own (None), or the stiffest.

    Raises:
        ModelError: for anything else.
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
    rubbing = model.tendon_frictionloss > 0
    model.tendon_solref_fri[rubbing] = stiff_time_constant_s(model), 1.0
    model.tendon_solimp_fri[rubbing] = np.array(STIFF_SOLIMP)


def make_dry(model: mujoco.MjModel, dofs: np.ndarray) -> None:
    """Make the dry friction of degrees of freedom (nv,) hard enough to be dry.

    MuJoCo's gives way: below a speed of f R / b, f the friction, R = (1 - d) / d times the joint's inverse inertia and
    b = 2 / (d tc) of its solref and solimp, it is viscous. With MuJoCo's defaults 0.4 N.m at the knee's coupler are so
    below 9 rad/s, since its own inertia is small; a machine would creep where it sticks.
    """
    model.dof_solref[dofs] = stiff_time_constant_s(model), 1.0
    model.dof_solimp[dofs] = np.array(STIFF_SOLIMP)
