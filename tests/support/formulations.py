"""The numbers of a continuous problem of one second-order coordinate and one effort, without its system."""

import numpy as np

from linkplan.planner.transcription.formulation import Formulation, PhaseBoundary, Units
from linkplan.planner.transcription.interval import IntervalRows


def formulation(*boundaries: PhaseBoundary, **changes) -> Formulation:
    """Return a coordinate in [-1, 1] with an effort in [-8, 8] and a path quantity, in units of 1 s and 4 N.m."""
    numbers = {
        "build_system": lambda: None, "n_s": 1, "n_x": 0, "n_z": 0, "n_u": 1, "rows": IntervalRows(),
        "units": Units(time_s=1.0, state=np.ones(2), effort=np.array([4.0]), objective=1.0),
        "state": np.array([[-1.0, 1.0], [-9.0, 9.0]]), "algebraic": np.zeros((0, 2)), "effort": np.array([[-8.0, 8.0]]),
        "path": np.array([[-2.0, 3.0]]), "own": {}, "boundaries": boundaries, "returns": (), "smooth": False,
        "eta": np.zeros(0), "theta": lambda times: np.zeros((*times.shape, 0)),
    }  # fmt: skip
    return Formulation(**numbers | changes)
