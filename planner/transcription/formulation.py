"""A continuous problem as the transcription takes it: functions at a node, and numbers for their bounds and parameters.

All is scaled: states, unknowns and time are of order one. Mechanisms and users' differential equations both become one of
these; what comes after knows neither.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from linkplan.planner.transcription.interval import IntervalRows
from linkplan.planner.transcription.system import Endpoint, System


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhaseBoundary:
    """A start, waypoint or goal: bounds (n_state, 2) on its state, bounds (2,) on its instant from the start.

    `share` puts it at a share of the whole duration in place of an instant.
    """

    state: np.ndarray
    time: tuple[float, float]
    share: float | None = None

    @property
    def fixed(self) -> bool:
        """Whether its instant is given."""
        return self.time[0] == self.time[1]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Units:
    """What the scaled unknowns are multiplied by: `time_s`, `state` (n_state,), `effort` (n_u,), `objective`."""

    time_s: float
    state: np.ndarray
    effort: np.ndarray
    objective: float


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Formulation:
    """Structure and numbers of a continuous problem.

    `build_system` makes the system when it is needed. Bounds are [low, high] rows: `state` (n_state, 2), `algebraic` (n_z,
    2), `effort` (n_u, 2) in its own units, `path` (n_path, 2), `own` by kind of an interval's own rows. `returns` are states
    that end as they began, but for what they have gone on by, `advance` (n_returns,) or nothing; `adrift` are those that
    need not, as nothing depends on them. `smooth` says whether efforts may not jump. `eta` are an interval's own parameters,
    `theta` maps times (n, m) [s] to those of nodes (n, m, n_theta). `tightening` maps breaks (n + 1,) [s] to how far
    (n, n_path) path bounds are tightened on each interval, `own_tightening` by kind how far (n, n_items) own ones are.
    `position_path` are path quantities that follow from the positions of the second-order coordinates alone: where a phase
    boundary gives those, nothing is left to bound. `passed` are values that path quantities have at phase boundaries on the
    way: (boundary, quantity, value).
    """

    build_system: Callable[[], System]
    n_s: int
    n_x: int
    n_z: int
    n_u: int
    rows: IntervalRows
    units: Units
    state: np.ndarray
    algebraic: np.ndarray
    effort: np.ndarray
    path: np.ndarray
    own: dict[str, np.ndarray]
    boundaries: tuple[PhaseBoundary, ...]
    returns: tuple[int, ...]
    smooth: bool
    eta: np.ndarray
    theta: Callable[[np.ndarray], np.ndarray]
    tightening: Callable[[np.ndarray], np.ndarray] | None = None
    own_tightening: dict[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)
    position_path: tuple[int, ...] = ()
    passed: tuple[tuple[int, int, float], ...] = ()
    advance: np.ndarray | float = 0.0
    adrift: tuple[int, ...] = ()
    endpoint: Endpoint | None = None
    endpoint_bounds: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    endpoint_parameters: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def periodic(self) -> bool:
        """Whether every state returns, but for those that are adrift."""
        return bool(self.returns) and len(self.returns) + len(self.adrift) == len(self.state)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Start:
    """A motion to start a solver from, scaled, as functions of times (n,) [s].

    `states` gives (n, n_state); `nodes` gives accelerations (n, n_s), rates (n, n_x), algebraic unknowns (n, n_z) and
    efforts (n, n_u), the latter in their own units.
    """

    states: Callable[[np.ndarray], np.ndarray]
    nodes: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]


def fitted(durations: np.ndarray, boundaries: tuple[PhaseBoundary, ...], phase: np.ndarray, time_s: float) -> np.ndarray:
    """Return segment durations [s] stretched so that phase boundaries with a given instant stand there."""
    durations = np.array(durations, dtype=float)
    begun, at = 0, 0.0
    for k, boundary in enumerate(boundaries[1:]):
        if boundary.fixed:
            group = (phase >= begun) & (phase <= k)
            durations[group] *= (boundary.time[0] * time_s - at) / durations[group].sum()
            begun, at = k + 1, boundary.time[0] * time_s
    return durations
