"""Evaluated gains: the loop of every joint at every pose, with the others closed, and its shortfall."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import UNSET, Struct, UnsetType
from msgspec.structs import asdict, force_setattr

from linkplan.controllers.sampling import Sampling
from linkplan.models.errors import LinkplanError
from linkplan.models.tree.joints import shown_by_unit
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint, SampledLaw, label_differences
from linkplan.studies.feedback.frequency.margins import LEAST_RESPONSE_AT_REST, Margins, margins
from linkplan.studies.feedback.frequency.quick import QuickMargins

# By default an error settles within this many cycles of the bandwidth, and poles have at least this damping ratio.
SETTLING_CYCLES, LEAST_DAMPING_RATIO = 5.0, 0.4
# The shortfall of unstable gains, larger than any shortfall of stable ones.
UNSTABLE_SHORTFALL = 10.0


class Requirements(Struct, frozen=True, kw_only=True, eq=False):
    """The requirements at the worst pose.

    The least bandwidth [Hz] of the complementary sensitivity (-3 dB), the least phase margin [deg], the largest peak of |S|
    (None: any), the longest settling time [s] to 2 % of an error (default: `SETTLING_CYCLES` over the bandwidth), the least
    damping ratio. At rest the least stiffness [N.m/rad or N/m] or, if None, the response to a small step, within 1 -
    `response_at_rest`.
    """

    bandwidth_hz: float
    phase_margin_deg: float
    sensitivity_peak: float | None = None
    settling_s: float = np.nan
    damping_ratio: float = LEAST_DAMPING_RATIO
    stiffness: float | None = None
    response_at_rest: float | None = LEAST_RESPONSE_AT_REST

    @property
    def largest_peak(self) -> float:
        """The largest allowed peak of |S|; infinite without a requirement."""
        return np.inf if self.sensitivity_peak is None else self.sensitivity_peak

    def __post_init__(self) -> None:
        if not 0 <= self.phase_margin_deg < 180:
            raise LinkplanError(f"the required phase margin must be from 0 to 180 degrees, got {self.phase_margin_deg:g}")
        if not self.largest_peak > 1:
            raise LinkplanError(f"the required peak of the sensitivity must be above 1, got {self.sensitivity_peak:g}")
        if np.isnan(self.settling_s):
            force_setattr(self, "settling_s", SETTLING_CYCLES / self.bandwidth_hz)
        if not 0 <= self.damping_ratio <= 1:
            raise LinkplanError(f"the damping ratio must be from 0 to 1, got {self.damping_ratio:g}")
        if self.stiffness is not None:
            force_setattr(self, "response_at_rest", None)

    def shortfall_at_rest(self, response: np.ndarray | float | None, stiffness: np.ndarray | float | None) -> np.ndarray:
        """Return the relative shortfall of responses and stiffnesses at rest: negative with a reserve, infinite for None."""
        if response is None or stiffness is None:
            return np.array(np.inf)
        if self.stiffness is not None:
            return 1.0 - np.asarray(stiffness) / self.stiffness
        return np.abs(1.0 - np.asarray(response)) / (1.0 - (self.response_at_rest or 0.0)) - 1.0


class JudgedLoop(Margins, frozen=True, kw_only=True, eq=False):
    """The margins of the loop of one joint at one pose, with the other joints' loops closed.

    It is a subclass of the margins, so that the JSON has them as keys of the loop. The position is that of the only joint
    with a loop; with several loops there are the positions of all joints by name, and `joint` is the loop's own.
    """

    joint: str | UnsetType = UNSET
    position_deg: float | dict[str, float] | UnsetType = UNSET
    position_m: float | dict[str, float] | UnsetType = UNSET
    point: Beside[OperatingPoint] = NOT_READ
    channel: Beside[int] = NOT_READ

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
        known = [(v, i) for i, loop in enumerate(self.loops) if (v := getattr(loop, name)) is not None]
        value, index = (max(known) if largest else min(known)) if known else (None, 0)
        return value, self.loops[index]

    def farthest_at_rest(self) -> JudgedLoop:
        """Return the loop that settles farthest from its reference after a step."""
        return max(self.loops, key=lambda loop: abs(1.0 - (loop.response_at_rest or 0.0)))


def evaluated(points: Sequence[OperatingPoint], wanted: Requirements, law: SampledLaw) -> EvaluatedGains:
    """Return a law with the loops of all joints at all points, and the largest relative shortfall."""
    channels = points[0].mechanism.channels
    loops = [_judged(point, channel, law) for channel in channels for point in label_differences(points)]
    short = [float(shortfall(loop, wanted, law.timing)) if loop.stable else UNSTABLE_SHORTFALL for loop in loops]
    return EvaluatedGains(law=law, loops=tuple(loops), shortfall=float(np.clip(max(short), 0.0, UNSTABLE_SHORTFALL)))


def _judged(point: OperatingPoint, channel: int, law: SampledLaw) -> JudgedLoop:
    try:
        found = margins(law.loop(point), channel)
    except LinkplanError:
        found = Margins(stable=False)
    joints, channels = point.mechanism.independent_joints, list(point.mechanism.channels)
    own, at = joints[channel], shown_by_unit([joints[k] for k in channels], point.state[channels])
    place: dict[str, Any] = {"joint": own.name, "position_deg": at["deg"], "position_m": at["m"]}
    if len(channels) == 1:
        place = {f"position_{own.unit}": own.shown(point.state[channels[0]])}
    return JudgedLoop(**asdict(found), **place, point=point, channel=channel)


def shortfall(found: Margins | QuickMargins, wanted: Requirements, timing: Sampling, reserve: float = 1.0) -> np.ndarray:
    """Return the largest relative shortfall (n,) of margins of stable loops, one or n: negative with a reserve.

    `reserve` is a factor on the requirements. If it is not a number, it is `UNSTABLE_SHORTFALL`.
    """
    band, phase = (np.inf if x is None else x for x in (found.bandwidth_hz, found.phase_margin_deg))
    with np.errstate(divide="ignore", invalid="ignore"):
        short = [
            np.log(wanted.bandwidth_hz * reserve / np.minimum(band, timing.nyquist_hz)),
            found.sensitivity_peak * reserve / wanted.largest_peak - 1.0,
            np.log(found.settling_s * reserve / wanted.settling_s),
            wanted.damping_ratio * reserve - found.damping_ratio,
            wanted.shortfall_at_rest(found.response_at_rest, found.stiffness_at_rest),
        ]
        if wanted.phase_margin_deg:
            short.append(1.0 - phase / (wanted.phase_margin_deg * reserve))
    return np.max([np.nan_to_num(x, nan=UNSTABLE_SHORTFALL, posinf=UNSTABLE_SHORTFALL) for x in short], axis=0)
