"""Forces on sites: a load on a foot, a tyre's force, a weight on a hook.

A constant force is an actuator without gain in the model itself, so that it is the same in MuJoCo, in the symbolic dynamics
and in an exported model. Its line of action moves with the site; its size and its direction in the world do not change. A
force over time is a parameter of the symbolic dynamics, and a simulation applies it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np

from linkplan.models.errors import ModelError, choose
from linkplan.models.kinematics import clamped_joints


class ForceCurve(Protocol):
    """Columns over time, which may repeat."""

    @property
    def periodic(self) -> bool:
        """Whether the columns repeat."""
        ...

    def derivative(self, time_s: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the derivative of the given order at times (n,) [s], as (n, k)."""
        ...

    def inner_times(self, duration_s: float) -> np.ndarray:
        """Return the times [s] inside a duration at which one cubic ends and the next begins."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class ForcesOverTime:
    """Forces on sites by name; `curve` has the columns (3 n_sites,) [N]: x, y, z in the world of each site in turn."""

    sites: tuple[str, ...]
    curve: ForceCurve


def omitted_forces(forces: ForcesOverTime | None, where: str) -> str | None:
    """Return the note that forces over time, which belong to a motion, are omitted in a study without one, or None."""
    return None if forces is None else f"force_over_time on {', '.join(forces.sites)} is omitted {where}"


# The site at the world's origin whose axes are those of the forces.
_AXES_NAME = "world axes"


def add_forces(spec: mujoco.MjSpec, forces: Mapping[str, Sequence[float]]) -> None:
    """Add constant forces (3,) [N] on sites by name to a specification.

    Raises:
        ModelError: for an unknown site, or one that a joint moves whose actuatorfrcrange would clamp the force too.
    """
    sites = {site.name: site for site in spec.sites if site.name}
    acting = {choose("site in mechanism.force", name, sites): force for name, force in forces.items() if np.any(force)}
    for name, force in acting.items():
        if _AXES_NAME not in sites:
            sites[_AXES_NAME] = spec.worldbody.add_site(name=_AXES_NAME)
        one = spec.add_actuator(name=f"force on {name}", target=name, trntype=mujoco.mjtTrn.mjTRN_SITE, refsite=_AXES_NAME)
        one.gear = [*force, 0.0, 0.0, 0.0]
        one.gaintype, one.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        one.gainprm[0], one.biasprm[0] = 0.0, 1.0
    model = spec.compile() if acting else None
    for name in acting:
        for joint in clamped_joints(model, model.site(name).id):
            raise ModelError(
                f"mechanism.force on site '{name}': the actuatorfrcrange of joint '{model.joint(joint).name}' would clamp"
                " the force with the motors' efforts; limit the motors by their forcerange or ctrlrange instead"
            )
