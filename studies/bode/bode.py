"""The study behind `linkplan bode`: a tracker's loop over joint angles, predicted and measured, with its worst case."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.sampling import Sampling, sampling
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import ContactPair
from linkplan.models.poses.reach import reach
from linkplan.planner.planning import silent
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.bode.scan import Line, Scan, coordinate_line, judge_of, scan_line, with_room
from linkplan.studies.bode.touching import touched, touching
from linkplan.studies.frequency.excitation import Setup
from linkplan.studies.frequency.feedback_loops import (
    CONTINUOUS,
    QUANTITIES,
    SIMULATED,
    FeedbackLoop,
    OperatingPoint,
    feedback_loop,
    law_gain,
    operating_point,
)
from linkplan.studies.frequency.margins import Margins, frequency_grid, margins
from linkplan.studies.frequency.measure import measure
from linkplan.studies.frequency.response import Response
from linkplan.studies.frequency.trial import MOST_PERIODS, settle_trials

POINTS = 5
# Over a reach, five evenly and the two next to its ends, where gains are extreme (a singular end itself has none): as
# shares of it.
_OVER_THE_REACH = (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99)
SCANNED = 41
# A worst pose within this share of a line of one that is looked at is that one.
_SAME = 1e-3
# Positions tried for whether the actuators hold them.
_LOOKED = 81
FREQUENCIES = 20
# Where to measure by default, from and to, in units of the crossover, and never beyond this share of the sampling rate.
_FROM, _TO, _SHARE = 1 / 20, 40.0, 0.45
_SLOWEST_HZ = 1.0
# Control periods for which loops are tried that contacts disturb: a simulated contact takes ten times as long as none.
_DISTURBED_PERIODS = 4_000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BodePoint:
    """The loop of one joint at one pose: predicted, tried and, where it is stable and was asked for, measured.

    `measured` and `predicted` hold the responses of `feedback_loops.QUANTITIES` at the same frequencies.
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
        """Where."""
        return self.sampled.point


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BodeStudy:
    """A tracker's loops over several poses, and the margins over the whole reach."""

    mechanism: Mechanism
    law: str
    settings: Tracking
    timing: Sampling
    effort_limit: np.ndarray
    points: tuple[BodePoint, ...]
    scans: tuple[Scan, ...]
    method: str | None
    simulated_steps: int
    conditions: dict
    contacts: tuple[ContactPair, ...] = ()  # of geoms, at the operating points by index

    @property
    def stable(self) -> bool:
        """Whether the sampled loop is stable at every pose looked at, and MuJoCo's own run of it too."""
        return all(point.margins.stable and point.settles_in_mujoco for point in self.points)

    @property
    def disputed(self) -> tuple[str, ...]:
        """The poses at which MuJoCo's own run settles and the sampled model is unstable, or the other way round."""
        return tuple(dict.fromkeys(p.point.name for p in self.points if p.margins.stable != p.settles_in_mujoco))

    @property
    def loop_name(self) -> str:
        """The loop in words."""
        settings = self.settings
        name = self.law if self.law == "lqr" else settings.gains_text(self.mechanism.independent_joints)
        name += f" sampled every {settings.period_s:g} s"
        if self.timing.delay_steps:
            name += f" with a delay of {self.timing.delay_s / settings.period_s:g} period(s)"
        return name

    @property
    def worst_deviation(self) -> tuple[float, float] | None:
        """The largest difference between measured and predicted closed loops, where coherent: [dB], [deg]."""
        worst = []
        for point in self.points:
            for name in ("complementary", "reference"):
                if name in point.measured:
                    measured = point.measured[name]
                    db, deg = measured.against(point.predicted[name])
                    seen = measured.coherence > 0.99
                    worst.append((np.abs(db[seen]).max(initial=0.0), np.abs(deg[seen]).max(initial=0.0)))
        return None if not worst else (float(max(w[0] for w in worst)), float(max(w[1] for w in worst)))

    @property
    def message(self) -> str:
        """The verdict in a sentence."""
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
                f" {_counted(len(poses))}), by softness of the closures, contacts or limits that the model leaves out:"
                f" {self.loop_name}"
            )
        text = f"stable at {'the pose' if len(poses) == 1 else f'all {len(poses)} poses'}: {self.loop_name}"
        known = [p for p in self.points if p.margins.phase_margin_deg is not None]
        if known:
            least = min(known, key=lambda p: p.margins.phase_margin_deg)
            text += f", phase margin {least.margins.phase_margin_deg:.1f} deg at the worst ({least.point.name})"
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


def default_poses(
    mechanism: Mechanism, positions: np.ndarray | None = None, effort_limit: np.ndarray | None = None
) -> tuple[np.ndarray, str | None]:
    """Return positions (n, n_s) to look at, and a sentence where the actuators cannot hold all that was to be looked at.

    For a single freedom five over given ones (m,), or seven over its reach, next to its ends too, of those that the efforts'
    limits (n_u, 2) hold at rest; of several freedoms home.
    """
    if mechanism.dof != 1:
        return mechanism.home[mechanism.independent][None], None
    if positions is not None and len(positions):
        low, high, shares = float(np.min(positions)), float(np.max(positions)), np.linspace(0.0, 1.0, POINTS)
    else:
        low, high = most_of_reach(mechanism, 0)
        shares = (np.array(_OVER_THE_REACH) - _OVER_THE_REACH[0]) / (_OVER_THE_REACH[-1] - _OVER_THE_REACH[0])
        if turns(mechanism, 0):  # there are no ends: as many poses a turn, evenly
            high, shares = high - (high - low) / len(shares), np.linspace(0.0, 1.0, len(shares))
    looked = np.linspace(low, high, _LOOKED)
    held = np.array([is_held(mechanism, np.array([position]), effort_limit) for position in looked])
    if held.all() or not held.any():  # where none is held, the first one's refusal says why
        return (low + shares * (high - low))[:, None], None
    kept, unheld, joint = looked[held], looked[~held], mechanism.independent_joints[0]
    return kept[(shares * (len(kept) - 1)).round().astype(int)][:, None], (
        f"poses are taken from {joint.name} = {joint.said(kept[0], 4)} to {joint.said(kept[-1], 4)} {joint.unit}; of"
        f" {len(looked)} from {joint.said(low, 4)} to {joint.said(high, 4)}, the actuators cannot hold {len(unheld)} at"
        f" rest, between {joint.said(unheld[0], 4)} and {joint.said(unheld[-1], 4)}"
    )


def is_held(mechanism: Mechanism, position: np.ndarray, effort_limit: np.ndarray | None) -> bool:
    """Return whether the actuators hold a position (n_s,) with some of their limits' range left to either side."""
    inside = with_room(mechanism.effort_limit if effort_limit is None else effort_limit)
    try:
        operating_point(mechanism, position, inside)
    except LinkplanError:
        return False
    return True


def turns(mechanism: Mechanism, coordinate: int) -> bool:
    """Return whether a coordinate is a hinge that nothing stops in a whole turn."""
    return mechanism.independent_joints[coordinate].kind == "hinge" and reach(mechanism, coordinate).turns_fully


def most_of_reach(mechanism: Mechanism, coordinate: int) -> tuple[float, float]:
    """Return what lies next to the ends of a joint's reach; of one that nothing stops, a whole turn about home."""
    can = reach(mechanism, coordinate)
    low, high = can.lower.position, can.upper.position
    home = float(mechanism.home[mechanism.independent[coordinate]])
    if can.turns_fully or not np.isfinite(high - low):
        half = np.pi if mechanism.independent_joints[coordinate].kind == "hinge" else 0.5 * mechanism.extent_m
        return home - half, home + half
    return low + _OVER_THE_REACH[0] * (high - low), low + _OVER_THE_REACH[-1] * (high - low)


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
    scanned: int = SCANNED,
    line: Line | None = None,
) -> BodeStudy:
    """Return a tracker's loops at independent positions (n, n_s) [rad or m].

    Margins are least over continuous lines, too: along `line`, of which the worst pose is then among those looked at, or
    over the reach of each coordinate.

    Args:
        mechanism: of which every freedom has its actuator.
        positions: where to look.
        settings: gains, period and delay.
        effort_limit: (n_u, 2) [N.m or N].
        say: hears about progress.
        law: pd, pd+ff or lqr.
        setup: how to measure; None measures nothing.
        frequency_hz: where to measure; None for twenty about the crossover.
        scanned: positions of the coarse scan of a line; 0 for none.
        line: what the poses stand for: a motion, or a reach, whose worst pose belongs to the answer; None where the poses
            themselves were asked for.

    Raises:
        LinkplanError: for a pose that cannot be held, or frequencies beyond Nyquist.
    """
    timing = sampling(mechanism, settings.period_s, settings.delay_periods)
    if frequency_hz is not None:
        _refuse_frequencies(frequency_hz, timing)
    positions = np.atleast_2d(positions)
    for position in positions:
        operating_point(mechanism, position, effort_limit)  # refuses what cannot be held before any work
    lines: list[tuple[int | None, Line]] = []
    if scanned:
        own = 0 if mechanism.dof == 1 else None
        lines = _reach_lines(mechanism, positions) if line is None else [(own, line)]
    scans = tuple(_scans(mechanism, lines, settings, effort_limit, timing, law, scanned, say))
    if line is not None:
        positions = _with_worst(positions, scans)
    where = [operating_point(mechanism, position, effort_limit) for position in positions]
    loops, ideal = [], []
    for point in where:
        say(f"predicted at {point.name}")
        gain = law_gain(point, law, settings, effort_limit)
        loops.append(feedback_loop(point, gain, timing, SIMULATED))
        ideal.append(feedback_loop(point, gain, timing, CONTINUOUS))
    pairs = touching(mechanism, loops)
    disturbed = touched(pairs, len(loops))
    trials = _settles(loops, disturbed, effort_limit)
    points, steps, conditions = [], 0, {}
    for channel in range(mechanism.dof):
        bounds = [margins(loop, channel) for loop in loops]
        measured: list[dict[str, Response]] = [{} for _ in loops]
        stable = [i for i, loop in enumerate(loops) if loop.stable and not disturbed[i]]
        if setup is not None and stable:
            at = default_frequencies([bounds[i] for i in stable], timing) if frequency_hz is None else frequency_hz
            taken = measure([loops[i] for i in stable], at, effort_limit, setup, channel=channel, say=say)
            steps, conditions = steps + taken.simulated_steps, taken.conditions
            for i, responses in zip(stable, taken.responses, strict=True):
                measured[i] = responses
        for i, (loop, line) in enumerate(zip(loops, ideal, strict=True)):
            points.append(
                BodePoint(
                    sampled=loop,
                    continuous=line,
                    channel=channel,
                    margins=bounds[i],
                    continuous_margins=margins(line, channel),
                    settles_in_mujoco=bool(trials[i]),
                    measured=measured[i],
                    predicted={q: loop.response(q, r.frequency_hz, channel) for q, r in measured[i].items()},
                )
            )
    return BodeStudy(
        mechanism=mechanism,
        law=law,
        settings=settings,
        timing=timing,
        effort_limit=np.array(effort_limit),
        points=tuple(points),
        scans=scans,
        method=None if setup is None else setup.method,
        simulated_steps=steps,
        conditions=conditions,
        contacts=pairs,
    )


def _settles(loops: Sequence[FeedbackLoop], disturbed: np.ndarray, effort_limit: np.ndarray) -> np.ndarray:
    """Return which loops (n,) settle in MuJoCo; those that contacts disturb never calm down, and are tried for less long."""
    settles = np.zeros(len(loops), dtype=bool)
    for those, periods in ((~disturbed, MOST_PERIODS), (disturbed, _DISTURBED_PERIODS)):
        if those.any():
            some = [loops[i] for i in np.flatnonzero(those)]
            settles[those] = settle_trials(some, effort_limit, periods).settles
    return settles


def _scans(mechanism, lines: Sequence[tuple[int | None, Line]], settings, effort_limit, timing, law: str, count: int, say):
    """Yield the margins along lines: of the coordinate that a line is of, of every one's where it is of a motion."""
    for coordinate, line in lines:
        say(f"margins over {line.name} from {line.said(line.low, 4)} to {line.said(line.high, 4)} {line.unit}")
        for channel in range(mechanism.dof) if coordinate is None else [coordinate]:
            judge = judge_of(mechanism, settings, effort_limit, timing, law, [channel])

            def at(x: float, judge=judge, line=line) -> Margins | None:
                found = judge(line.at(x))
                return None if found is None else found[0]

            positions, found = scan_line(at, line.low, line.high, count)
            if found:
                yield Scan(channel=channel, line=line, positions=positions, margins=found)


def _reach_lines(mechanism: Mechanism, positions: np.ndarray) -> list[tuple[int | None, Line]]:
    """Return the line over the reach of each coordinate, as far as positions (n, n_s) go too; the others as at the first."""
    lines: list[tuple[int | None, Line]] = []
    for channel in range(mechanism.dof):
        low, high = most_of_reach(mechanism, channel)
        ends = min(low, positions[:, channel].min()), max(high, positions[:, channel].max())
        lines.append((channel, coordinate_line(mechanism, channel, *map(float, ends), positions[0])))
    return lines


def _with_worst(positions: np.ndarray, scans: Sequence[Scan]) -> np.ndarray:
    """Return positions (n, n_s), the worst of each scan among them where it is none yet."""
    for scan in scans:
        s = scan.line.at(scan.positions[scan.worst])
        if np.abs(positions - s).max(axis=1).min() > _SAME * max(1e-9, np.ptp(scan.line.states, axis=0).max()):
            positions = np.vstack([positions, s])
    if positions.shape[1] == 1:
        positions = positions[np.argsort(positions[:, 0])]
    return positions


def default_frequencies(bounds: Sequence[Margins], timing: Sampling, count: int = FREQUENCIES) -> np.ndarray:
    """Return frequencies (n,) [Hz] about the loops' crossovers, up to 0.45 of the sampling rate."""
    crossings = [f for m in bounds if m.crossover_hz for f in (m.crossover_hz, *m.other_crossovers_hz)]
    crossings = crossings or [0.05 / timing.period_s]
    high = min(_SHARE / timing.period_s, _TO * max(crossings))
    low = min(crossings) * _FROM
    low = min(max(low, min(_SLOWEST_HZ, min(crossings) / 4)), 0.1 * high)
    return np.geomspace(low, high, count)


def _refuse_frequencies(frequency_hz: np.ndarray, timing: Sampling) -> None:
    frequency = np.asarray(frequency_hz, dtype=float)
    if not (frequency.size and np.all(np.isfinite(frequency)) and frequency.min() > 0):
        raise LinkplanError("frequencies are positive numbers of hertz")
    if frequency.max() > timing.nyquist_hz * (1 + 1e-9):
        raise LinkplanError(
            f"{frequency.max():.6g} Hz is above the Nyquist frequency, {timing.nyquist_hz:.6g} Hz at a control period of"
            f" {timing.period_s:g} s"
        )


def response_curves(loop: FeedbackLoop, channel: int, quantities: Sequence[str] = tuple(QUANTITIES)) -> dict[str, Response]:
    """Return a loop's predicted responses on the dense grid, for figures."""
    grid = frequency_grid(loop.timing.period_s)[::2]
    return {quantity: loop.response(quantity, grid, channel) for quantity in quantities}
