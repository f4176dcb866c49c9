"""The study of `linkplan bode`: a tracker's loop at several poses, predicted and measured, and the worst case."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import UNSET, structs

from linkplan.controllers.sampling import Sampling
from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.models.mechanism import Joint, Mechanism
from linkplan.models.poses.contacts import contact_pairs
from linkplan.models.poses.reach import reach
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import silent
from linkplan.studies.check.softness import gap_sentence, held_gap
from linkplan.studies.feedback.bode.bode_report import BodeStudy, loop_text
from linkplan.studies.feedback.bode.bode_result import BodePoint, PoseLoops, WorstMargins, pose_values
from linkplan.studies.feedback.bode.scan import PoseLine, Scan, contact_sentence, coordinate_line, scan_line, touched
from linkplan.studies.feedback.frequency.excitation import EXCITATIONS, Setup
from linkplan.studies.feedback.frequency.feedback_loops import (
    CONTINUOUS,
    EXACT,
    FeedbackLoop,
    OperatingPoint,
    SampledLaw,
    broken_at,
    feedback_loop,
    label_differences,
    operating_point,
    outputs_of,
    plant_name,
    refuse_above_nyquist,
    sampled_law,
    with_lqr_errors,
)
from linkplan.studies.feedback.frequency.margins import Margins, margins
from linkplan.studies.feedback.frequency.response import Response, largest_deviation
from linkplan.studies.feedback.frequency.simulated_loops import MAX_TRIAL_PERIODS, settle_trials
from linkplan.studies.feedback.frequency.sinestream import measure
from linkplan.studies.feedback.frequency.transfer_function import plant_modes
from linkplan.studies.output.plan_blocks import radius_figure

# Default poses as shares of the reach: five evenly spaced, and one close to each end, where gains are extreme. The end
# itself may be singular.
REACH_SHARES = (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99)
SCAN_POSITIONS = 41
# A worst pose closer to a chosen pose than this share of the line counts as the chosen pose.
SAME_POSE_SHARE = 1e-3
# Trial periods of loops with contacts. A simulated contact takes about ten times the time.
_CONTACT_TRIAL_PERIODS = 4_000
# The margins whose least values over a line are reported, and the responses whose measured deviation is reported.
LEAST_MARGINS = ("gain_margin_db", "gain_reduction_margin_db", "phase_margin_deg", "disk_margin", "bandwidth_hz")
CLOSED_LOOPS = ("complementary", "reference")


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
    line: PoseLine | None = None,
    note: str | None = None,
) -> BodeStudy:
    """Return a tracker's loops at independent positions (n, n_s) [rad or m].

    Margins are also scanned along continuous lines: along `line`, whose worst pose is then added to the positions, or over
    the reach of each coordinate.

    Args:
        mechanism: with an actuator.
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
    chosen, _ = law_at(mechanism, positions, law, settings, effort_limit, frequency_hz)
    scans = tuple(_scans(positions, line, chosen, scanned, mechanism, say)) if scanned else ()
    if line is not None:
        positions = _with_worst(positions, scans)
    loops, ideal = [], []
    for point in label_differences([operating_point(mechanism, position, effort_limit) for position in positions]):
        say(f"predicted at {point.name}")
        loops.append(chosen.loop(point))
        ideal.append(chosen.loop(point, CONTINUOUS))
    pairs = contact_pairs(mechanism, np.array([loop.point.pose for loop in loops]))
    in_contact = touched(pairs, len(loops))
    trials = _settles(loops, in_contact, effort_limit)
    stable = [i for i, loop in enumerate(loops) if loop.stable and not in_contact[i]]
    found, steps, conditions = [], 0, {}
    for channel in mechanism.channels:
        bounds = [margins(loop, channel) for loop in loops]
        measured: dict[int, dict[str, Response]] = {}
        if setup is not None and stable:
            at = loop_frequencies([bounds[i] for i in stable], chosen.timing) if frequency_hz is None else frequency_hz
            taken = measure([loops[i] for i in stable], at, effort_limit, setup, channel=channel, say=say)
            steps, conditions = steps + taken.simulated_steps, taken.conditions
            measured = dict(zip(stable, taken.responses, strict=True))
        found += [
            _point(loop, ideal[i], channel, bounds[i], bool(trials[i]), measured.get(i)) for i, loop in enumerate(loops)
        ]
    joints, name = mechanism.independent_joints, loop_text(mechanism, chosen)
    disputed = tuple(dict.fromkeys(point.point.name for point in found if point.stable != point.settles_in_mujoco))
    return BodeStudy(
        mechanism_name=mechanism.name,
        stable=all(point.stable and point.settles_in_mujoco for point in found),
        message=_message(found, disputed, name),
        tracker=law,
        gains={name: getattr(chosen.settings, name) for name in (*_gain_names(law, joints[0]), "period_s", "delay_periods")},
        disputed=disputed,
        softness=softness_of([loop.point for loop in loops]),
        contacts=contact_sentence(pairs, len(loops)),
        loops=_by_pose(mechanism, law, found),
        worst={joints[scan.channel].name: _worst(mechanism, scan) for scan in scans},
        measurement=_measurement(found, steps, conditions) if steps else None,
        note=note,
        mechanism=mechanism,
        law=chosen,
        scans=scans,
        is_measured=setup is not None,
    )


def law_at(
    mechanism: Mechanism,
    positions: np.ndarray,
    law: str,
    settings: Tracking,
    effort_limit: np.ndarray,
    frequency_hz: np.ndarray | None,
) -> tuple[SampledLaw, list[OperatingPoint]]:
    """Return a law and the operating points at independent positions (n, n_s); LQR's weights are for these points.

    Raises:
        LinkplanError: for a pose that cannot be held, or frequencies (m,) to measure at above the Nyquist frequency.
    """
    chosen = sampled_law(mechanism, law, settings, effort_limit)
    if frequency_hz is not None:
        refuse_above_nyquist(np.asarray(frequency_hz, dtype=float), settings.period_s)
    points = [operating_point(mechanism, s, effort_limit) for s in positions]
    if chosen.by_errors:
        chosen = replace(chosen, settings=with_lqr_errors(settings, mechanism, points, effort_limit))
    return chosen, points


def _point(
    loop: FeedbackLoop, ideal: FeedbackLoop, channel: int, bounds: Margins, settles: bool, taken: dict[str, Response] | None
) -> BodePoint:
    """Return the loop of one joint at one pose; `taken` are its measured responses."""
    responses, predicted = {}, {}
    along = {plant_name(loop.point.mechanism, channel, k): k for k in outputs_of(loop.point.mechanism, channel)[1:]}
    for name, response in (taken or {}).items():
        quantity = "plant" if name in along else name
        predicted[name] = loop.response(quantity, response.frequency_hz, channel, along.get(name))
        responses[name] = response.beside(predicted[name])
    return BodePoint(
        **structs.asdict(bounds),
        broken_at=broken_at(loop.point.mechanism, channel),
        settles_in_mujoco=settles,
        continuous=margins(ideal, channel),
        machine_spectral_radius=feedback_loop(loop.point, loop.gain, loop.timing, EXACT).radius,
        measured=responses or UNSET,
        plant=plant_modes(loop.point, channel) if along else UNSET,
        channel=channel,
        sampled=loop,
        ideal=ideal,
        predicted=predicted,
    )


def _by_pose(mechanism: Mechanism, law: str, points: Sequence[BodePoint]) -> list[PoseLoops]:
    """Return the loops of all joints at each pose, by the law and, if there are several, the joint."""
    found: dict[bytes, PoseLoops] = {}
    for entry in points:
        at = entry.point
        row = PoseLoops(
            **pose_values(at),
            reduced_inertia_kgm2=float(at.inertia[0, 0]) if mechanism.dof == 1 else at.inertia.tolist(),
            loops={},
        )
        several = len(mechanism.channels) > 1
        name = f"{law} {mechanism.independent_joints[entry.channel].name}" if several else law
        found.setdefault(at.pose.tobytes(), row).loops[name] = entry
    return list(found.values())


def _worst(mechanism: Mechanism, scan: Scan) -> WorstMargins:
    """Return the worst margins of a scan, and the least value of each."""
    joint, line = mechanism.independent_joints[scan.channel], scan.line
    key = f"position_{joint.unit}" if line.name == joint.name else "time_s"
    place: dict[str, Any] = {key: line.shown(scan.positions[scan.worst])}
    least = {name: found for name in LEAST_MARGINS if (found := scan.least(name)) is not None}
    return WorstMargins(
        **structs.asdict(scan.margins[scan.worst]),
        **place,
        least={name: {"value": value, key: line.shown(scan.positions[k])} for name, (value, k) in least.items()},
    )


def _measurement(points: Sequence[BodePoint], steps: int, conditions: dict) -> dict[str, Any]:
    """Return the method, the largest difference between measured and predicted closed loops, and the conditions."""
    closed = [point.responses[name] for point in points for name in CLOSED_LOOPS if name in point.responses]
    off_db, off_deg = largest_deviation(closed)
    return {
        "method": "sinestream",
        "excitations": list(EXCITATIONS),
        "simulated_steps": steps,
        "closed_loop_deviation_db": off_db,
        "closed_loop_deviation_deg": off_deg,
        **conditions,
    }


def _gain_names(law: str, joint: Joint) -> tuple[str, str]:
    """Return the keys of a law's two gains."""
    if not BUILT_IN[law].by_errors:
        return "kp", "kd"
    return ("lqr_position_m", "lqr_velocity_m_s") if joint.kind == "slide" else ("lqr_position_deg", "lqr_velocity_deg_s")


def softness_of(points: Sequence[OperatingPoint]) -> str | None:
    """Return the sentence on the closure gap at the poses, or None if it is small."""
    mechanism = points[0].mechanism
    gaps = [held_gap(mechanism, point.pose, point.hold) for point in points]
    return gap_sentence(mechanism, max(gaps), error=" while the poses are held")


def _message(points: Sequence[BodePoint], disputed: Sequence[str], loop: str) -> str:
    """Return the verdict as a sentence."""
    mechanism = points[0].point.mechanism
    joint, count = mechanism.independent_joints[0], len({p.point.name for p in points})
    counted = f"{count} pose{'s' * (count > 1)}"
    if bad := list(dict.fromkeys(p.point.name for p in points if not p.stable)):
        where = "; ".join(bad)
        if mechanism.dof == 1:
            numbers = ", ".join(name.split(" = ", 1)[1].removesuffix(f" {joint.unit}") for name in bad)
            where = f"{joint.name} = {numbers} {joint.unit}"
        settled = dict.fromkeys(p.point.name for p in points if p.settles_in_mujoco and not p.stable)
        dispute = f"; MuJoCo's own run settles at {'; '.join(settled)}" if settled else ""
        return f"unstable at {where} ({len(bad)} of {counted}): {loop}{dispute}"
    if disputed:
        return (
            f"stable by the sampled model but not in MuJoCo at {'; '.join(disputed)} ({len(disputed)} of {counted}), because"
            f" the model omits soft closures, contacts and limits: {loop}"
        )
    text = f"stable at {f'all {counted}' if count > 1 else 'the pose'}: {loop}"
    known = [(margin, p.point.name) for p in points if (margin := p.phase_margin_deg) is not None]
    wrong = [(radius, p.point.name) for p in points if (radius := p.machine_spectral_radius or 0.0) >= 1]
    if wrong:
        largest, where = max(wrong)
        steps = "the machine itself, sampled without the damping that the simulator's steps add,"
        return f"{text}; {steps} is unstable at {where}: largest pole {radius_figure(largest)}"
    if known:
        least, where = min(known)
        of_several = f", least phase margin of these {counted} {least:.1f} deg ({where})"
        text += of_several if count > 1 else f", phase margin {least:.1f} deg"
    return text


def _settles(loops: Sequence[FeedbackLoop], in_contact: np.ndarray, effort_limit: np.ndarray) -> np.ndarray:
    """Return True for each loop (n,) that settles in MuJoCo.

    Loops in contact never come to rest, so their trial is short.
    """
    settles = np.zeros(len(loops), dtype=bool)
    for chosen, periods in ((~in_contact, MAX_TRIAL_PERIODS), (in_contact, _CONTACT_TRIAL_PERIODS)):
        if chosen.any():
            tried = [loops[i] for i in np.flatnonzero(chosen).tolist()]
            settles[chosen] = settle_trials(tried, effort_limit, periods)
    return settles


def _scans(
    positions: np.ndarray,
    line: PoseLine | None,
    law: SampledLaw,
    count: int,
    mechanism: Mechanism,
    say: Callable[[str], None],
) -> Iterator[Scan]:
    """Yield the margins along `line` for all loops; without a line, over each coordinate's reach for its own loop.

    A reach is extended to include all positions (n, n_s). Other coordinates have their values of the first position.
    """
    lines = [] if line is None else [(line, mechanism.channels)]
    for channel in mechanism.channels if line is None else ():
        low, high = inner_reach(mechanism, channel)
        low, high = min(low, float(positions[:, channel].min())), max(high, float(positions[:, channel].max()))
        lines.append((coordinate_line(mechanism, channel, low, high, positions[0]), (channel,)))
    for one, channels in lines:
        say(f"margins over {one.name} from {one.text(one.low, 4)} to {one.text(one.high, 4)} {one.unit}")
        for channel in channels:
            if (found := scan_line(mechanism, one, law, channel, count)) is not None:
                yield found


def _with_worst(positions: np.ndarray, scans: Sequence[Scan]) -> np.ndarray:
    """Return positions (n, n_s) with the worst of each scan added, unless it is already present."""
    for scan in scans:
        s = scan.line.at(scan.positions[scan.worst])
        if np.abs(positions - s).max(axis=1).min() > SAME_POSE_SHARE * max(1e-9, np.ptp(scan.line.states, axis=0).max()):
            positions = np.vstack([positions, s])
    if positions.shape[1] == 1:
        positions = positions[np.argsort(positions[:, 0])]
    return positions


def loop_frequencies(bounds: Sequence[Margins], timing: Sampling) -> np.ndarray:
    """Return twenty frequencies [Hz] from 1/20 to 40 times the loops' crossovers, up to 0.45 of the sampling rate.

    They start at 1 Hz or below.
    """
    crossings = [f for m in bounds if m.crossover_hz for f in (m.crossover_hz, *m.other_crossovers_hz)]
    crossings = crossings or [0.05 / timing.period_s]
    high = min(0.45 / timing.period_s, 40.0 * max(crossings))
    low = min(max(min(crossings) / 20, min(1.0, min(crossings) / 4)), 0.1 * high)
    return np.geomspace(low, high, 20)
