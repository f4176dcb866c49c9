"""Margins along a continuous line: a scan, with every local minimum of the disk, gain and phase margin refined."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import LinkplanError, counted, listed
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import ContactPair, exclusion
from linkplan.planner.problem.limits import within_reserve
from linkplan.studies.check.holding import EFFORT_RESERVE
from linkplan.studies.feedback.frequency.feedback_loops import SampledLaw, operating_point
from linkplan.studies.feedback.frequency.margins import Margins, margins
from linkplan.studies.feedback.frequency.worst import refined_minima
from linkplan.studies.output.plan_blocks import radius_figure

# A parameter below this share of its line is shown as zero: a minimum is only found to the square root of rounding.
_ZERO_SHARE = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PoseLine:
    """A continuous line of positions s (n_s,) [rad or m]. Its parameter is a coordinate's position or the time [s]."""

    name: str
    unit: str
    factor: float  # from the line's parameter to the shown number in `unit`
    low: float
    high: float
    nodes: np.ndarray  # (m,) parameters, increasing
    states: np.ndarray  # (m, n_s)

    def at(self, x: float) -> np.ndarray:
        """Return the independent positions (n_s,) at a parameter."""
        return np.array([np.interp(x, self.nodes, column) for column in self.states.T])

    def shown(self, x: float) -> float:
        """Return a parameter in the line's display unit."""
        return float(self.factor * x)

    def text(self, x: float, digits: int = 4) -> str:
        """Return a parameter as text, with rounding errors of zero shown as zero."""
        return f"{0.0 if abs(x) < _ZERO_SHARE * (self.high - self.low) else self.shown(x):.{digits}g}"

    def place(self, x: float) -> str:
        """Return a parameter as text with name and unit."""
        return f"{self.name} = {self.text(x, 4)} {self.unit}"


def coordinate_line(mechanism: Mechanism, channel: int, low: float, high: float, others: np.ndarray) -> PoseLine:
    """Return the line of a coordinate from low to high [rad or m], with the other coordinates as in `others` (n_s,)."""
    joint = mechanism.independent_joints[channel]
    states = np.tile(np.asarray(others, dtype=float), (2, 1))
    states[:, channel] = low, high
    return PoseLine(
        name=joint.name,
        unit=joint.unit,
        factor=joint.shown(1.0),
        low=low,
        high=high,
        nodes=np.array([low, high]),
        states=states,
    )


def motion_line(time_s: np.ndarray, positions: np.ndarray) -> PoseLine:
    """Return the line of a motion: positions (m, n_s) at times (m,) [s]."""
    low, high = float(time_s[0]), float(time_s[-1])
    return PoseLine(name="t", unit="s", factor=1.0, low=low, high=high, nodes=np.array(time_s), states=np.array(positions))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scan:
    """Margins of one coordinate's loop along a line at parameters (n,), which include every local minimum."""

    channel: int
    line: PoseLine
    positions: np.ndarray
    margins: tuple[Margins, ...]

    def column(self, name: str) -> np.ndarray:
        """Return the values (n,) of one field of the margins, NaN where it is None."""
        return figures(self.margins, name)

    @property
    def worst(self) -> int:
        """The index of the worst margins: unstable ones first, then the smallest disk margin."""
        return int(np.argmin([stability(m) for m in self.margins]))

    def least(self, name: str) -> tuple[float, int] | None:
        """Return the smallest value of a figure along the line and its index, or None if there is no value."""
        values = np.where(np.isnan(self.column(name)), np.inf, self.column(name))
        k = int(np.argmin(values))
        return (float(values[k]), k) if np.isfinite(values[k]) else None


def figures(bounds: Sequence[Margins], name: str) -> np.ndarray:
    """Return one figure (n,) of margins, NaN where it is None."""
    return np.array([getattr(one, name) for one in bounds], dtype=float)


def stability(found: Margins | None) -> float:
    """Return the disk margin of a stable loop, or 1 - |pole| < 0 of an unstable one. Both are zero at the border.

    The result is infinite for `None` and for a stable loop without a disk margin.
    """
    if found is None:
        return np.inf
    if found.stable:
        return np.inf if found.disk_margin is None else found.disk_margin
    return 1.0 - (found.spectral_radius or 2.0)


def scan_line(mechanism: Mechanism, line: PoseLine, law: SampledLaw, channel: int, count: int) -> Scan | None:
    """Return the margins of a coordinate's loop along a line, at positions that efforts can hold; None if there are none.

    `count` parameters are evenly spaced. The others are the local minima of `stability` and, if all loops are stable, of
    the gain and the phase margin.
    """
    judge = judge_of(mechanism, line, law, [channel])

    def at(x: float) -> Margins | None:
        found = judge(x)
        return found[0] if found else None

    def figure(name: str, x: float) -> float:
        value = getattr(at(x), name, None)
        return np.inf if value is None else value

    even = np.linspace(line.low, line.high, count)
    places = {float(x) for x in even} | set(refined_minima(lambda x: stability(at(x)), even))
    if all(bounds is None or bounds.stable for bounds in map(at, places)):
        for name in ("gain_margin_db", "gain_reduction_margin_db", "phase_margin_deg"):
            places |= set(refined_minima(functools.partial(figure, name), even))
    known = {x: bounds for x in sorted(places) if (bounds := at(x)) is not None}
    if not known:
        return None
    return Scan(channel=channel, line=line, positions=np.array([*known]), margins=tuple(known.values()))


def bounds_text(bounds: Margins) -> str:
    """Return the disk margin of a stable loop or the largest pole of an unstable one, as text."""
    if bounds.stable:
        return f"disk margin {bounds.disk_margin:.3g}"
    return f"unstable, largest pole {radius_figure(bounds.spectral_radius)}"


def judge_of(
    mechanism: Mechanism, line: PoseLine, law: SampledLaw, channels: Sequence[int]
) -> Callable[[float], list[Margins]]:
    """Return the function from a line's parameter to the margins of the channels' loops; None where no effort holds it."""
    inside = within_reserve(law.effort_limit, EFFORT_RESERVE)

    @functools.cache
    def judge(x: float) -> list[Margins]:
        try:
            loop = law.loop(operating_point(mechanism, line.at(x), inside))
            return [margins(loop, channel, refine=False) for channel in channels]
        except LinkplanError:  # the pose cannot be held, or LQR has no stabilising gain
            return []

    return judge


def touched(pairs: Sequence[ContactPair], n: int) -> np.ndarray:
    """Return True for each of n loops that has geoms in contact, (n,)."""
    found = np.zeros(n, dtype=bool)
    for pair in pairs:
        found[list(pair.poses)] = True
    return found


def contact_sentence(pairs: Sequence[ContactPair], n: int) -> str | None:
    """Return a sentence on the three deepest contacts at n poses, or None if there is no contact."""
    if not pairs:
        return None
    deepest = sorted(pairs, key=lambda pair: -pair.depth_m)
    named = listed([" and ".join(pair.geoms) for pair in deepest], 3)
    exclusions = " ".join(dict.fromkeys(exclusion(pair.bodies) for pair in deepest[:3]))
    count = int(touched(pairs, n).sum())
    return (
        f"contacts of {named} push in MuJoCo at {count} of {counted(n, 'pose')}, up to"
        f" {1e3 * deepest[0].depth_m:.2g} mm deep; the prediction omits them, they open the kinematic loops, and no response"
        f" is measured there; {exclusions} in the model's <contact> lets links pass side by side"
    )
