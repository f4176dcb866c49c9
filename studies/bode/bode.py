"""The study behind `linkplan bode`: a tracker's loop at several poses, predicted and measured, and the worst case."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.controllers.sampling import Sampling
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import ContactPair, contact_pairs
from linkplan.models.poses.reach import reach
from linkplan.planner.planning import silent
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.bode.scan import Line, Scan, coordinate_line, scan_line
from linkplan.studies.bode.touching import touched
from linkplan.studies.frequency.excitation import Setup
from linkplan.studies.frequency.feedback_loops import (
    CONTINUOUS,
    FeedbackLoop,
    OperatingPoint,
    SampledLaw,
    label_differences,
    operating_point,
    refuse_above_nyquist,
    sampled_law,
    with_lqr_errors,
)
from linkplan.studies.frequency.margins import Margins, margins
from linkplan.studies.frequency.measure import measure
from linkplan.studies.frequency.response import Response
from linkplan.studies.frequency.trial import MAX_TRIAL_PERIODS, settle_trials

# Default poses as shares of the reach: five evenly, and one close to each end, where gains are extreme. The end itself may
# be singular.
REACH_SHARES = (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99)
SCAN_POSITIONS = 41
# A worst pose closer than this share of the line to a chosen pose is that pose.
SAME_POSE_SHARE = 1e-3
# Trial periods of loops with contacts. A simulated contact takes about ten times the time.
_CONTACT_TRIAL_PERIODS = 4_000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BodePoint:
    """The loop of one joint at one pose: its prediction, its stability trial in MuJoCo and its measured responses.

    `measured` and `predicted` hold the responses of `feedback_loops.QUANTITIES` at the same frequencies. Both are empty for
    an unstable loop, and if no measurement was requested.
    """

    sampled: FeedbackLoop
    continuous: FeedbackLoop
    channel: int
    margins: Margins
    continuous_margins: Margins
    settles_in_mujoco: bool
    measured: dict[str, Response]
    predicted: dict[str, Response]

    @property
    def point(self) -> OperatingPoint:
        """The operating point."""
        return self.sampled.point


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BodeStudy:
    """A tracker's loops at several poses, and the margins over the whole reach."""

    mechanism: Mechanism
    law: SampledLaw
    points: tuple[BodePoint, ...]
    scans: tuple[Scan, ...]
    is_measured: bool
    simulated_steps: int
    conditions: dict
    note: str | None = None  # on the choice of the poses
    contacts: tuple[ContactPair, ...] = ()  # pairs of geoms, with the indices of the operating points where they touch

    @property
    def stable(self) -> bool:
        """True if the sampled loop is stable at every pose, by the model and in MuJoCo."""
        return all(point.margins.stable and point.settles_in_mujoco for point in self.points)

    @property
    def disputed(self) -> tuple[str, ...]:
        """The poses at which the sampled model and the MuJoCo run disagree about stability."""
        return tuple(dict.fromkeys(p.point.name for p in self.points if p.margins.stable != p.settles_in_mujoco))

    @property
    def loop_name(self) -> str:
        """The tracker with its gains, period and delay, as text."""
        settings, timing = self.law.settings, self.law.timing
        name = "lqr" if self.law.name == "lqr" else settings.gains_text(self.mechanism.independent_joints)
        name += f" sampled every {settings.period_s:g} s"
        if timing.delay_steps:
            name += f" with a delay of {timing.delay_s / settings.period_s:g} period(s)"
        return name

    @property
    def worst_deviation(self) -> tuple[float, float] | None:
        """The largest difference between measured and predicted closed loops at coherent frequencies: [dB], [deg]."""
        worst = []
        for point in self.points:
            for name in ("complementary", "reference"):
                if name in point.measured:
                    measured = point.measured[name]
                    db, deg = measured.against(point.predicted[name])
                    coherent = measured.coherence > 0.99
                    worst.append((np.abs(db[coherent]).max(initial=0.0), np.abs(deg[coherent]).max(initial=0.0)))
        return None if not worst else (float(max(w[0] for w in worst)), float(max(w[1] for w in worst)))

    @property
    def message(self) -> str:
        """The verdict as a sentence."""
        bad = list(dict.fromkeys(p.point.name for p in self.points if not p.margins.stable))
        poses = list(dict.fromkeys(p.point.name for p in self.points))
        if bad:
            where = ", ".join(name.split(" = ", 1)[1].removesuffix(f" {self._unit}") for name in bad)
            if self.mechanism.dof == 1:
                where = f"{self.mechanism.independent_joints[0].name} = {where} {self._unit}"
            else:
                where = "; ".join(bad)
            return f"unstable at {where} ({len(bad)} of {_counted(len(poses))}): {self.loop_name}{self._dispute}"
        if self.disputed:
            return (
                f"stable by the sampled model and not in MuJoCo at {'; '.join(self.disputed)} ({len(self.disputed)} of"
                f" {_counted(len(poses))}), because the model omits soft closures, contacts and limits: {self.loop_name}"
            )
        text = f"stable at {'the pose' if len(poses) == 1 else f'all {len(poses)} poses'}: {self.loop_name}"
        known = [(margin, p.point.name) for p in self.points if (margin := p.margins.phase_margin_deg) is not None]
        if known:
            text += ", phase margin {:.1f} deg at the worst ({})".format(*min(known))
        return text

    @property
    def _dispute(self) -> str:
        settled = [p.point.name for p in self.points if p.settles_in_mujoco and not p.margins.stable]
        return f"; MuJoCo's own run settles at {'; '.join(dict.fromkeys(settled))}" if settled else ""

    @property
    def _unit(self) -> str:
        return self.mechanism.independent_joints[0].unit


def _counted(n: int) -> str:
    return "1 pose" if n == 1 else f"{n} poses"


def inner_reach(mechanism: Mechanism, coordinate: int) -> tuple[float, float]:
    """Return a joint's reach [rad or m] without 1 % at each end; for an unlimited joint, a period about home."""
    can = reach(mechanism, coordinate)
    low, high = can.once
    if can.turns_fully and mechanism.independent_joints[coordinate].kind == "slide":
        return can.home - 0.5 * mechanism.extent_m, can.home + 0.5 * mechanism.extent_m
    if can.turns_fully:
        return low, high
    return low + REACH_SHARES[0] * (high - low), low + REACH_SHARES[-1] * (high - low)


def bode_study(
    mechanism: Mechanism,
    positions: np.ndarray,
    settings: Tracking,
    effort_limit: np.ndarray,
    say: Callable[[str], None] = silent,
    *,
    law: str = "pd",
    setup: Setup | None = None,
    frequency_hz: np.ndarray | None = None,
    scanned: int = SCAN_POSITIONS,
    line: Line | None = None,
    note: str | None = None,
) -> BodeStudy:
    """Return a tracker's loops at independent positions (n, n_s) [rad or m].

    Margins are also scanned along continuous lines: along `line`, whose worst pose is then added to the positions, or over
    the reach of each coordinate.

    Args:
        mechanism: with one actuator for each degree of freedom.
        positions: the poses.
        settings: gains, period and delay.
        effort_limit: (n_u, 2) [N.m or N].
        say: receives progress messages.
        law: pd, pd+ff or lqr.
        setup: settings of the measurement; None measures nothing.
        frequency_hz: (m,) to measure at; None for twenty around the crossover.
        scanned: positions of the coarse scan of a line; 0 for none.
        line: the motion or reach that the positions sample; None if the user gave the poses.
        note: on the choice of the positions, for the report.

    Raises:
        LinkplanError: for a pose that cannot be held, or frequencies above the Nyquist frequency.
    """
    positions = np.atleast_2d(positions)
    chosen = sampled_law(mechanism, law, settings, effort_limit)
    if frequency_hz is not None:
        refuse_above_nyquist(np.asarray(frequency_hz, dtype=float), settings.period_s)
    points = [operating_point(mechanism, s, effort_limit) for s in positions]  # or refuses a pose, before any work
    if law == "lqr":
        chosen = replace(chosen, settings=with_lqr_errors(settings, mechanism, points, effort_limit))
    lines = _scan_lines(mechanism, positions, line) if scanned else []
    scans = tuple(_scans(mechanism, lines, chosen, scanned, say))
    if line is not None:
        positions = _with_worst(positions, scans)
    loops, ideal = _predicted(mechanism, positions, chosen, say)
    pairs = contact_pairs(mechanism, np.array([loop.point.pose for loop in loops]))
    in_contact = touched(pairs, len(loops))
    trials = _settles(loops, in_contact, effort_limit)
    stable = [i for i, loop in enumerate(loops) if loop.stable and not in_contact[i]]
    found, steps, conditions = [], 0, {}
    for channel in mechanism.channels:
        bounds = [margins(loop, channel) for loop in loops]
        measured: dict[int, dict[str, Response]] = {}
        if setup is not None and stable:
            at = default_frequencies([bounds[i] for i in stable], chosen.timing) if frequency_hz is None else frequency_hz
            taken = measure([loops[i] for i in stable], at, effort_limit, setup, channel=channel, say=say)
            steps, conditions = steps + taken.simulated_steps, taken.conditions
            measured = dict(zip(stable, taken.responses, strict=True))
        for i, loop in enumerate(loops):
            responses = measured.get(i, {})
            point = BodePoint(
                sampled=loop,
                continuous=ideal[i],
                channel=channel,
                margins=bounds[i],
                continuous_margins=margins(ideal[i], channel),
                settles_in_mujoco=bool(trials[i]),
                measured=responses,
                predicted={q: loop.response(q, r.frequency_hz, channel) for q, r in responses.items()},
            )
            found.append(point)
    return BodeStudy(
        mechanism=mechanism,
        law=chosen,
        points=tuple(found),
        scans=scans,
        is_measured=setup is not None,
        simulated_steps=steps,
        conditions=conditions,
        note=note,
        contacts=pairs,
    )


def _predicted(
    mechanism: Mechanism, positions: np.ndarray, law: SampledLaw, say: Callable[[str], None]
) -> tuple[list[FeedbackLoop], list[FeedbackLoop]]:
    """Return the sampled and the continuous loops at positions (n, n_s)."""
    loops, ideal = [], []
    for point in label_differences([operating_point(mechanism, position, law.effort_limit) for position in positions]):
        say(f"predicted at {point.name}")
        loops.append(law.loop(point))
        ideal.append(law.loop(point, CONTINUOUS))
    return loops, ideal


def _settles(loops: Sequence[FeedbackLoop], in_contact: np.ndarray, effort_limit: np.ndarray) -> np.ndarray:
    """Return True for each loop (n,) that settles in MuJoCo. Loops in contact never come to rest: their trial is short."""
    settles = np.zeros(len(loops), dtype=bool)
    for chosen, periods in ((~in_contact, MAX_TRIAL_PERIODS), (in_contact, _CONTACT_TRIAL_PERIODS)):
        if chosen.any():
            tried = [loops[i] for i in np.flatnonzero(chosen).tolist()]
            settles[chosen] = settle_trials(tried, effort_limit, periods)
    return settles


def _scans(
    mechanism: Mechanism,
    lines: Sequence[tuple[int | None, Line]],
    law: SampledLaw,
    count: int,
    say: Callable[[str], None],
) -> Iterator[Scan]:
    """Yield the margins along lines: a coordinate's line for that coordinate's loop, a motion's line for all loops."""
    for coordinate, line in lines:
        say(f"margins over {line.name} from {line.said(line.low, 4)} to {line.said(line.high, 4)} {line.unit}")
        for channel in mechanism.channels if coordinate is None else [coordinate]:
            if (found := scan_line(mechanism, line, law, channel, count)) is not None:
                yield found


def _scan_lines(mechanism: Mechanism, positions: np.ndarray, line: Line | None) -> list[tuple[int | None, Line]]:
    """Return the lines to scan, with their coordinate or None for a motion.

    By default there is a line for each coordinate over its reach and all positions (n, n_s). The other coordinates are as
    in the first position.
    """
    if line is not None:
        return [(0 if mechanism.dof == 1 else None, line)]
    lines: list[tuple[int | None, Line]] = []
    for channel in mechanism.channels:
        low, high = inner_reach(mechanism, channel)
        low, high = min(low, float(positions[:, channel].min())), max(high, float(positions[:, channel].max()))
        lines.append((channel, coordinate_line(mechanism, channel, low, high, positions[0])))
    return lines


def _with_worst(positions: np.ndarray, scans: Sequence[Scan]) -> np.ndarray:
    """Return positions (n, n_s) with the worst of each scan added, unless it is already present."""
    for scan in scans:
        s = scan.line.at(scan.positions[scan.worst])
        if np.abs(positions - s).max(axis=1).min() > SAME_POSE_SHARE * max(1e-9, np.ptp(scan.line.states, axis=0).max()):
            positions = np.vstack([positions, s])
    if positions.shape[1] == 1:
        positions = positions[np.argsort(positions[:, 0])]
    return positions


def default_frequencies(bounds: Sequence[Margins], timing: Sampling) -> np.ndarray:
    """Return twenty frequencies [Hz] from 1/20 to 40 times the loops' crossovers, up to 0.45 of the sampling rate.

    They start at 1 Hz or below.
    """
    crossings = [f for m in bounds if m.crossover_hz for f in (m.crossover_hz, *m.other_crossovers_hz)]
    crossings = crossings or [0.05 / timing.period_s]
    high = min(0.45 / timing.period_s, 40.0 * max(crossings))
    low = min(max(min(crossings) / 20, min(1.0, min(crossings) / 4)), 0.1 * high)
    return np.geomspace(low, high, 20)
