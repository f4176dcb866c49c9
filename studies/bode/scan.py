"""Margins over a continuous coordinate: scanned, every local minimum of stability, gain and phase margin refined."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.sampling import Sampling
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.frequency.feedback_loops import OperatingPoint, feedback_loop, law_gain, operating_point
from linkplan.studies.frequency.margins import Margins, margins
from linkplan.studies.frequency.worst import local_minima

# A parameter below this share of its line is zero to people: where a figure is least is found to the root of rounding.
_NOTHING = 1e-6
# What an actuator is to have left beside what holds a default pose, of its range: room for a loop to answer in.
_ROOM = 0.05
# The figures whose local minima are refined beside that of stability.
_LEAST = ("gain_margin_db", "phase_margin_deg")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Line:
    """A continuous line of positions s (n_s,) [rad or m], by a coordinate's position or by the time along a motion [s]."""

    name: str
    unit: str
    factor: float  # of what people are shown, in `unit`, over the line's own parameter
    low: float
    high: float
    nodes: np.ndarray  # (m,) parameters, increasing
    states: np.ndarray  # (m, n_s)

    def at(self, x: float) -> np.ndarray:
        """Return the independent positions (n_s,) at a parameter."""
        return np.array([np.interp(x, self.nodes, column) for column in self.states.T])

    def shown(self, x: float) -> float:
        """Return a parameter in the unit for people."""
        return float(self.factor * x)

    def said(self, x: float, digits: int = 4) -> str:
        """Return a parameter as people read it: what is rounding of zero is zero."""
        return f"{0.0 if abs(x) < _NOTHING * (self.high - self.low) else self.shown(x):.{digits}g}"

    def place(self, x: float) -> str:
        """Return a parameter for people."""
        return f"{self.name} = {self.said(x, 4)} {self.unit}"


def coordinate_line(mechanism: Mechanism, channel: int, low: float, high: float, others: np.ndarray) -> Line:
    """Return the line of a coordinate from one position to another [rad or m], the others as in `others` (n_s,)."""
    joint = mechanism.independent_joints[channel]
    states = np.tile(np.asarray(others, dtype=float), (2, 1))
    states[:, channel] = low, high
    return Line(
        name=joint.name,
        unit=joint.unit,
        factor=joint.shown(1.0),
        low=low,
        high=high,
        nodes=np.array([low, high]),
        states=states,
    )


def motion_line(time_s: np.ndarray, positions: np.ndarray) -> Line:
    """Return the line of a motion: positions (m, n_s) at times (m,) [s]."""
    low, high = float(time_s[0]), float(time_s[-1])
    return Line(name="t", unit="s", factor=1.0, low=low, high=high, nodes=np.array(time_s), states=np.array(positions))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scan:
    """Margins of one coordinate's loop along a line: parameters (n,), the margins at each, every local worst among them."""

    channel: int
    line: Line
    positions: np.ndarray
    margins: tuple[Margins, ...]

    def column(self, name: str) -> np.ndarray:
        """Return a figure (n,) of the margins, not a number where it is none."""
        return np.array([np.nan if getattr(m, name) is None else getattr(m, name) for m in self.margins], dtype=float)

    @property
    def worst(self) -> int:
        """The index of the worst margins: unstable before stable, then by the disk margin."""
        return int(np.argmin([stability(m) for m in self.margins]))

    def least(self, name: str) -> tuple[float, int] | None:
        """Return the least of a figure along the line, and its index; None where it is nowhere known."""
        values = np.where(np.isnan(self.column(name)), np.inf, self.column(name))
        k = int(np.argmin(values))
        return (float(values[k]), k) if np.isfinite(values[k]) else None


def stability(found: Margins | None) -> float:
    """Return the disk margin, or 1 - |pole| below zero of an unstable loop: both vanish at the border; infinite for none."""
    if found is None:
        return np.inf
    if found.stable:
        return np.inf if found.disk_margin is None else found.disk_margin
    return 1.0 - (found.spectral_radius or 2.0)


def scan_line(
    judge: Callable[[float], Margins | None], low: float, high: float, count: int
) -> tuple[np.ndarray, tuple[Margins, ...]]:
    """Return places (n,) from low to high, increasing, and the margins there; where `judge` has none the place is left out.

    `count` places are even, the others are the local minima of stability and, where all is stable, of gain and phase margin.
    """
    known: dict[float, Margins | None] = {}

    def at(x: float) -> Margins | None:
        if x not in known:
            known[x] = judge(x)
        return known[x]

    even = np.linspace(low, high, count)
    places = {float(x) for x in even} | set(local_minima(lambda x: stability(at(x)), even))
    if all(m is None or m.stable for m in known.values()):
        for name in _LEAST:

            def figure(x: float, name: str = name) -> float:
                value = None if (m := at(x)) is None else getattr(m, name)
                return np.inf if value is None else value

            places |= set(local_minima(figure, even))
    kept = [x for x in sorted(places) if at(x) is not None]
    return np.array(kept), tuple(m for x in kept if (m := at(x)) is not None)


def with_room(effort_limit: np.ndarray) -> np.ndarray:
    """Return limits (n_u, 2) within which a pose is to be held, so that a loop about it has room to answer in."""
    limit = np.array(effort_limit, dtype=float)
    room = _ROOM * np.diff(limit, axis=1).ravel()
    return np.where(np.isfinite(room)[:, None], limit + np.outer(np.where(np.isfinite(room), room, 0.0), [1.0, -1.0]), limit)


def judge_of(
    mechanism: Mechanism, settings: Tracking, effort_limit: np.ndarray, timing: Sampling, law: str, channels: Sequence[int]
) -> Callable[[np.ndarray], list[Margins] | None]:
    """Return what gives the margins of coordinates' loops at positions (n_s,), None where no effort holds them."""
    inside = with_room(effort_limit)

    def judge(s: np.ndarray) -> list[Margins] | None:
        try:
            point: OperatingPoint = operating_point(mechanism, s, inside)
            loop = feedback_loop(point, law_gain(point, law, settings, effort_limit), timing)
            return [margins(loop, channel, refine=False) for channel in channels]
        except LinkplanError:  # a stretch that cannot be held, or not be stabilised, has no margins
            return None

    return judge
