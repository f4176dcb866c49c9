"""What built-in trackers are built from, for references that stand apart from any plan."""

from typing import Any

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.tracker import Design, Errors
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.settings import Tracking


def designed(
    mechanism: Mechanism,
    reference: SampledReference,
    errors: tuple[Any, Any, Any] = (1.0, 1.0, 1.0),
    limit: float = np.inf,
    **settings: Any,
) -> Design:
    """Return a design with errors of unit cost (position, velocity, effort), one effort limit and settings of [tracking]."""
    position, velocity, effort = errors
    return Design(
        mechanism=mechanism,
        reference=reference,
        settings=Tracking(**settings),
        errors=lambda: Errors(position=position, velocity=velocity, effort=effort),
        effort_limit=np.tile([-limit, limit], (mechanism.n_u, 1)),
        compile_mode="never",
    )
