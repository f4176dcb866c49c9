"""The solution of a user's optimal-control problem as continuous functions of time."""

from dataclasses import dataclass

import numpy as np

from linkplan.planner.problem.settings import frozen
from linkplan.planner.trajectory import OnIntervals
from linkplan.planner.transcription.bernstein import PiecewisePolynomial


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OdeTrajectory(OnIntervals):
    """States and efforts as polynomials: Bernstein coefficients (degree + 1, n, n_x) and (degree + 1, n, n_u).

    `breaks_s` (n + 1,) are the intervals' ends [s]. `running` (n,) is what intervals add to the running cost by the
    transcription's own quadrature; None for a motion that no program had.
    """

    breaks_s: np.ndarray
    state: np.ndarray
    effort: np.ndarray
    running: np.ndarray | None = None

    def __post_init__(self) -> None:
        for name in ("breaks_s", "state", "effort", "running"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else frozen(value))

    def state_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return states (n, n_x) at times (n,)."""
        return PiecewisePolynomial(self.state, self.breaks_s)(np.atleast_1d(time_s))

    def rate_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return the states' rates (n, n_x) at times (n,)."""
        return PiecewisePolynomial(self.state, self.breaks_s).derivative()(np.atleast_1d(time_s))

    def effort_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return efforts (n, n_u) at times (n,); at a break the later interval's."""
        return PiecewisePolynomial(self.effort, self.breaks_s)(np.atleast_1d(time_s))
