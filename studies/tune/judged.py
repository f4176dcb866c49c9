"""Judged gains: the loop of every joint at every pose, with the others closed, and what it lacks of the requirements."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.sampling import Sampling
from linkplan.models.errors import LinkplanError
from linkplan.studies.frequency.feedback_loops import OperatingPoint, SampledLaw, label_differences
from linkplan.studies.frequency.margins import Margins, margins
from linkplan.studies.frequency.rest import LEAST_RESPONSE_AT_REST

# By default an error settles within this many cycles of the bandwidth, and poles have at least this damping ratio.
SETTLING_CYCLES, LEAST_DAMPING_RATIO = 5.0, 0.4
# The shortfall of unstable gains, larger than any shortfall of stable ones.
UNSTABLE_SHORTFALL = 10.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Wanted:
    """The requirements at the worst pose.

    The least bandwidth [Hz] of the complementary sensitivity (-3 dB), the least phase margin [deg], the largest peak of |S|,
    the longest settling time [s] to 2 % of an error (None: `SETTLING_CYCLES` over the bandwidth), the least damping ratio.
    At rest the least stiffness [N.m/rad or N/m] or, if None, the response to a small step, within 1 - `response_at_rest`.
    """

    bandwidth_hz: float
    phase_margin_deg: float
    sensitivity_peak: float = np.inf
    settling_s: float | None = None
    damping_ratio: float = LEAST_DAMPING_RATIO
    stiffness: float | None = None
    response_at_rest: float = LEAST_RESPONSE_AT_REST

    @property
    def longest_settling_s(self) -> float:
        """The longest settling time [s]."""
        return SETTLING_CYCLES / self.bandwidth_hz if self.settling_s is None else self.settling_s

    def __post_init__(self) -> None:
        if not (np.isfinite(self.bandwidth_hz) and self.bandwidth_hz > 0):
            raise LinkplanError(f"the wanted bandwidth is a positive number of hertz, got {self.bandwidth_hz:g}")
        if not 0 <= self.phase_margin_deg < 180:
            raise LinkplanError(f"the wanted phase margin is from 0 to 180 degrees, got {self.phase_margin_deg:g}")
        if not self.sensitivity_peak > 1:
            raise LinkplanError(f"the sensitivity's peak is wanted above 1, got {self.sensitivity_peak:g}")
        if self.settling_s is not None and not self.settling_s > 0:
            raise LinkplanError(f"the settling time is a positive number of seconds, got {self.settling_s:g}")
        if not 0 <= self.damping_ratio <= 1:
            raise LinkplanError(f"the damping ratio is from 0 to 1, got {self.damping_ratio:g}")
        if self.stiffness is not None and not (np.isfinite(self.stiffness) and self.stiffness > 0):
            raise LinkplanError(f"the stiffness at rest is a positive number of N.m/rad or N/m, got {self.stiffness:g}")

    def shortfall_at_rest(self, response: np.ndarray | float | None, stiffness: np.ndarray | float | None) -> np.ndarray:
        """Return the relative shortfall of responses and stiffnesses at rest: negative with a reserve, infinite for None."""
        if response is None or stiffness is None:
            return np.array(np.inf)
        if self.stiffness is not None:
            return 1.0 - np.asarray(stiffness) / self.stiffness
        return np.abs(1.0 - np.asarray(response)) / (1.0 - self.response_at_rest) - 1.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class JudgedLoop:
    """The margins of the loop of one joint at one pose, with the other joints' loops closed."""

    point: OperatingPoint
    channel: int
    margins: Margins

    @property
    def name(self) -> str:
        """The pose, and the joint if several joints have a loop, as text."""
        mechanism = self.point.mechanism
        single = len(mechanism.channels) == 1
        return self.point.name if single else f"{mechanism.independent_joints[self.channel].name} at {self.point.name}"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class EvaluatedGains:
    """A law with its loops, joint by joint and pose by pose, and the largest relative shortfall or zero."""

    law: SampledLaw
    loops: tuple[JudgedLoop, ...]
    shortfall: float

    def worst(self, name: str, largest: bool = False) -> tuple[float | None, JudgedLoop]:
        """Return the smallest (or largest) value of a figure and its loop; None without a value."""
        known = [(v, i) for i, loop in enumerate(self.loops) if (v := getattr(loop.margins, name)) is not None]
        value, index = (max(known) if largest else min(known)) if known else (None, 0)
        return value, self.loops[index]

    def farthest_at_rest(self) -> JudgedLoop:
        """Return the loop that settles farthest from a step of its reference."""
        return max(self.loops, key=lambda loop: abs(1.0 - (loop.margins.response_at_rest or 0.0)))


def evaluated(points: Sequence[OperatingPoint], wanted: Wanted, law: SampledLaw) -> EvaluatedGains:
    """Return a law with the loops of all joints at all points, and the largest relative shortfall."""
    channels = points[0].mechanism.channels
    loops = [_judged(point, channel, law) for channel in channels for point in label_differences(points)]
    lacking = max(min(shortfall(loop.margins, wanted, law.timing), UNSTABLE_SHORTFALL) for loop in loops)
    return EvaluatedGains(law=law, loops=tuple(loops), shortfall=float(max(0.0, lacking)))


def _judged(point: OperatingPoint, channel: int, law: SampledLaw) -> JudgedLoop:
    try:
        found = margins(law.loop(point), channel)
    except LinkplanError:
        found = Margins(stable=False)
    return JudgedLoop(point=point, channel=channel, margins=found)


def shortfall(found: Margins, wanted: Wanted, timing: Sampling) -> float:
    """Return the largest relative shortfall of margins: negative with a reserve, infinite without stability or bandwidth."""
    if not found.stable or found.bandwidth_hz == 0.0:
        return np.inf
    band = found.bandwidth_hz or timing.nyquist_hz
    short = [float(np.log(wanted.bandwidth_hz / band)), found.sensitivity_peak / wanted.sensitivity_peak - 1.0]
    if wanted.phase_margin_deg and found.phase_margin_deg is not None:
        short.append(1.0 - found.phase_margin_deg / wanted.phase_margin_deg)
    short.append(float(np.log(found.settling_s / wanted.longest_settling_s)))
    short.append(wanted.damping_ratio - found.damping_ratio)
    short.append(float(wanted.shortfall_at_rest(found.response_at_rest, found.stiffness_at_rest)))
    return max(short)
