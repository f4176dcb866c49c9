"""Feedforward: the efforts of the reference motion, added to another tracker's efforts."""

from dataclasses import dataclass

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.tracker import Tracker


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Feedforward:
    """u = u_ref + u_feedback, u_ref from the reduced inverse dynamics of the reference."""

    reference: SampledReference
    feedback: Tracker

    @property
    def name(self) -> str:
        """The feedback's name with "+ff"."""
        return f"{self.feedback.name}+ff"

    @property
    def batched(self) -> bool:
        """True if the feedback accepts leading batch axes."""
        return bool(getattr(self.feedback, "batched", False))

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N], with leading batch axes if the feedback accepts them."""
        return self.reference.effort[k] + self.feedback.effort(k, position, velocity)
