"""One batch of MuJoCo simulations in which each simulation has its own copy of the model fields that differ.

Separate models (`Batch.set_models`) give the same results, but a step takes half as long again, because each model's memory
is read separately.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch

# All model fields that an imperfection changes, and the fields that MuJoCo derives from them.
FIELDS = (
    "body_mass", "body_inertia", "body_ipos", "body_pos", "body_sameframe", "body_subtreemass", "body_invweight0",
    "dof_M0", "dof_damping", "dof_frictionloss", "dof_solref", "dof_solimp",
    "dof_invweight0", "dof_length", "site_pos", "site_sameframe",
    "geom_pos", "geom_sameframe", "eq_data", "eq_solref", "tendon_length0", "tendon_invweight0", "tendon_actfrcrange",
    "actuator_acc0", "actuator_length0", "actuator_ctrlrange", "actuator_forcerange", "jnt_actfrcrange",
    "cam_pos0", "cam_poscom0", "light_pos0", "light_poscom0",
)  # fmt: skip


def spread(batch: Batch, base: mujoco.MjModel, models: Sequence[mujoco.MjModel]) -> None:
    """Expand every field of a batch in which some model differs from the base model."""
    unlike = [model for model in models if model is not base]
    for name in FIELDS:
        common = getattr(base, name)
        if not all(np.array_equal(getattr(model, name), common) for model in unlike):
            batch.expand(name)[:] = [getattr(model, name) for model in models]
    timesteps = [model.opt.timestep for model in models]
    if any(step != base.opt.timestep for step in timesteps):
        batch.expand("opt.timestep")[:] = timesteps
