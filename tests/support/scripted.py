"""Linkages at home under efforts of a list: what drives a simulation where no tracker is to be tested."""

from dataclasses import dataclass

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.models.mechanism import Mechanism
from tests.support.mechanisms import replaced

PERIOD_S = 1e-3
STEPS = 100


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scripted:
    """A tracker that gives the k-th effort of a list, whatever it sees."""

    efforts: np.ndarray
    name: str = "scripted"

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        del position, velocity
        return self.efforts[k]


def hard(text: str, timestep: float = 1e-5, integrator: str = "Euler") -> str:
    """Return a model with loops as hard as its time step allows."""
    option = f'<option timestep="{timestep}" integrator="{integrator}"/>'
    return replaced(
        text, "<default>", f'{option}<default><equality solref="{2.5 * timestep} 1" solimp="0.999 0.9999 0.001"/>'
    )


def standing(mechanism: Mechanism, n: int = STEPS) -> SampledReference:
    """Return the reference of standing at home."""
    pose = np.tile(mechanism.home, (n, 1))
    still = np.zeros((n, mechanism.dof))
    return SampledReference(
        period_s=PERIOD_S,
        time_s=PERIOD_S * np.arange(n),
        pose_rad=pose,
        position_rad=pose[:, mechanism.independent],
        velocity_rad_s=still,
        effort=np.zeros((n, mechanism.n_u)),
        cycle=None,
    )


def wave(mechanism: Mechanism, size: float, n: int = 50) -> np.ndarray:
    """Return efforts (n, n_u) that rise and fall, each actuator's out of step with the others'."""
    t = PERIOD_S * np.arange(n)[:, None]
    return size * np.sin(60 * t + np.arange(mechanism.n_u))
