"""The input of a transcription: a continuous problem as functions at a node, with the values of bounds and parameters.

All quantities are scaled to order one. It knows no mechanisms.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from linkplan.planner.transcription.interval import IntervalRows
from linkplan.planner.transcription.system import Endpoint, System


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhaseBoundary:
    """A start, waypoint or goal: bounds (n_state, 2) on its state, bounds (2,) on its time since the start.

    `share` fixes the time as a share of the whole duration instead.
    """

    state: np.ndarray
    time: tuple[float, float]
    share: float | None = None

    @property
    def fixed(self) -> bool:
        """Whether its time is prescribed."""
        return self.time[0] == self.time[1]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Units:
    """Units of the scaled unknowns: `time_s`, `state` (n_state,), `effort` (n_u,), `objective`."""

    time_s: float
    state: np.ndarray
    effort: np.ndarray
    objective: float


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Formulation:
    """Structure and numbers of a continuous problem.

    `build_system` makes the system when it is needed. Bounds are [low, high] rows: `state` (n_state, 2), `algebraic` (n_z,
    2), `effort` (n_u, 2) in its own units, `path` (n_path, 2), and `own` by kind of an interval's own rows. `returns` are
    the periodic states; they end at their initial value plus `advance` (n_returns,). `free_at_end` are states that need not
    return, because nothing depends on them. `smooth` are efforts without jumps. `holds_at_rest` (start, goal) are weights
    (n, n_s) of sums of scaled accelerations that are zero if the motion rests there. `end_accelerations` (2, n_s) are
    scaled accelerations at moving ends, NaN where they are free. `end_efforts` (2, n_u, 2) bound the first and the last
    efforts. `eta` are an interval's own parameters. `theta` maps times (n, m) [s] to node parameters (n, m, n_theta).
    `tightening` maps breaks (n + 1,) [s] to amounts (n, n_path) by which path bounds are tightened on each interval, and
    `own_tightening` gives, by kind, amounts (n, n_items) for own rows. `position_path` are path quantities that depend only
    on the positions of second-order coordinates; they need no bound at phase boundaries that prescribe all positions.
    `passed` are prescribed values (boundary, quantity, value) of path quantities at waypoints. `peak` is the scaled cost of
    the largest share of the effort limits at any instant, a further unknown; None if it costs nothing.
    """

    build_system: Callable[[], System]
    n_s: int = 0
    n_x: int
    n_z: int = 0
    n_u: int
    rows: IntervalRows
    units: Units
    state: np.ndarray
    algebraic: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    effort: np.ndarray
    path: np.ndarray
    own: dict[str, np.ndarray]
    boundaries: tuple[PhaseBoundary, ...]
    returns: tuple[int, ...]
    smooth: tuple[int, ...] = ()
    holds_at_rest: tuple[np.ndarray, ...] = ()
    end_accelerations: tuple[np.ndarray, ...] | np.ndarray = (np.zeros(0), np.zeros(0))
    end_efforts: np.ndarray | None = None
    eta: np.ndarray = field(default_factory=lambda: np.zeros(0))
    theta: Callable[[np.ndarray], np.ndarray]
    tightening: Callable[[np.ndarray], np.ndarray] | None = None
    own_tightening: dict[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)
    position_path: tuple[int, ...] = ()
    passed: tuple[tuple[int, int, float], ...] = ()
    advance: np.ndarray | float = 0.0
    free_at_end: tuple[int, ...] = ()
    peak: float | None = None
    endpoint: Endpoint | None = None
    endpoint_bounds: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    endpoint_parameters: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def periodic(self) -> bool:
        """Whether every state returns except those free_at_end."""
        return bool(self.returns) and len(self.returns) + len(self.free_at_end) == len(self.state)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Start:
    """A scaled motion to start a solver from, as functions of times (n,) [s].

    `states` gives (n, n_state). `nodes` gives accelerations (n, n_s), rates (n, n_x), algebraic unknowns (n, n_z) and
    efforts (n, n_u); the efforts are in their own units, and the solver starts from at most `share_of_effort` of the limits.
    """

    states: Callable[[np.ndarray], np.ndarray]
    nodes: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]
    share_of_effort: float = 0.95


def stretched_durations(
    durations: np.ndarray, boundaries: tuple[PhaseBoundary, ...], phase: np.ndarray, time_s: float
) -> np.ndarray:
    """Return segment durations [s], stretched to meet the prescribed times of phase boundaries."""
    durations = np.array(durations, dtype=float)
    begun, at = 0, 0.0
    for k, boundary in enumerate(boundaries[1:]):
        if boundary.fixed:
            group = (phase >= begun) & (phase <= k)
            durations[group] *= (boundary.time[0] * time_s - at) / durations[group].sum()
            begun, at = k + 1, boundary.time[0] * time_s
    return durations
