"""The search for gains: a grid of natural frequency and damping ratio, refined around its best point, joint by joint."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.planner.problem.keys.kinds import LQR_ERRORS
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint, SampledLaw, law_gain
from linkplan.studies.feedback.frequency.quick import quick_loops
from linkplan.studies.feedback.frequency.rest import passive_stiffness
from linkplan.studies.feedback.frequency.stability_map import effort_map
from linkplan.studies.feedback.tune.requirements import UNSTABLE_SHORTFALL, Requirements, evaluated, shortfall

# Search range of the natural frequency, in units of the required bandwidth, and of the damping ratio.
_NATURAL_FREQUENCY_RANGE = (0.08, 4.0)
_DAMPING_RATIO_RANGE = (0.15, 8.0)
_GRID_LEVELS = 4
# The least share of kd^2 due to the velocity weight of an LQR; with less, the weight would have no effect.
_LEAST_EXTRA_DAMPING = 0.01
# The search uses approximate margins, so it requires this factor more than the user.
_SEARCH_RESERVE = 1.005
# Number of rounds: with the worst poses of a line added (at most two were needed in practice), and over the joints of
# several degrees of freedom, where each joint's gains are searched again with the latest gains of the others.
MAX_ROUNDS = 5


def found_gains(
    points: Sequence[OperatingPoint], wanted: Requirements, law: SampledLaw, say: Callable[[str], None]
) -> SampledLaw:
    """Return the law with the least shortfall at the points or, among those without, the least damping gain.

    Several joints first get gains of the same natural frequency and damping ratio, each for its own inertia. If these fall
    short, one joint's gains are searched at a time, with the loops of the others closed, in a few rounds over the joints
    (sequential loop closing, Skogestad & Postlethwaite, Multivariable Feedback Control, 2005, 10.6).
    """
    mechanism = points[0].mechanism
    channels, joints = mechanism.channels, mechanism.independent_joints
    if len(channels) == 1:
        return _refined(points, wanted, law, channels, say)
    zeros = {joint.name: 0.0 for joint in joints}  # passive spins have no gains
    first = replace(law, settings=law.settings.replace(kp=zeros, kd=zeros))
    best = evaluated(points, wanted, _refined(points, wanted, first, channels, say))
    law = best.law
    for number in range(MAX_ROUNDS):
        if best.shortfall == 0.0:
            break
        for channel in channels:
            name = joints[channel].name

            def told(words: str, number: int = number, name: str = name) -> None:
                say(f"{name}, round {number + 1}: {words}")

            law = _refined(points, wanted, law, [channel], told)
        found = evaluated(points, wanted, law)
        best = found if found.shortfall < best.shortfall else best
    return best.law


def _refined(
    points: Sequence[OperatingPoint],
    wanted: Requirements,
    law: SampledLaw,
    channels: Sequence[int],
    say: Callable[[str], None],
) -> SampledLaw:
    """Return the best gains of some joints on a grid that is refined around its best point; other joints keep theirs."""
    highest = max(_NATURAL_FREQUENCY_RANGE[1], 2 * _natural_at_rest(points, wanted, channels))
    ends = np.log([(_NATURAL_FREQUENCY_RANGE[0], highest), _DAMPING_RATIO_RANGE])
    centre, half = ends.mean(axis=1), 0.5 * np.diff(ends, axis=1).ravel()
    best: tuple[float, float, SampledLaw] | None = None
    several = law.by_errors or len(points[0].mechanism.channels) > 1
    # Grid points along each axis: fewer for LQR, which solves a Riccati equation for every candidate and pose, and for
    # several joints, whose loops are all evaluated for every candidate.
    count = 9 if several else 17
    for level in range(_GRID_LEVELS):
        say(f"gains, grid {level + 1} of {_GRID_LEVELS}" + ("" if best is None else f", shortfall {best[0]:.3g}"))
        axis = np.linspace(-1.0, 1.0, count)
        at = [(a, b) for a in centre[0] + half[0] * axis for b in centre[1] + half[1] * axis]
        candidates = [
            replace(law, settings=_settings(points, wanted, law, channels, *np.exp(place).tolist())) for place in at
        ]
        shortfalls = _shortfalls(points, candidates, wanted)
        # The damping gain increases with the product of natural frequency and damping ratio, the sum of their logarithms.
        ranked = min(range(len(at)), key=lambda i: (shortfalls[i], sum(at[i])))
        row = float(shortfalls[ranked]), sum(at[ranked]), candidates[ranked]
        if best is None or row[:2] <= best[:2]:
            best, centre = row, np.array(at[ranked])
        half = half * 2.5 / count
    return best[2]


def _natural_at_rest(points: Sequence[OperatingPoint], wanted: Requirements, channels: Sequence[int]) -> float:
    """Return the natural frequency [required bandwidths] of gains that meet the requirement at rest."""
    found = 0.0
    for point in points:
        stiffness = passive_stiffness(point).diagonal()
        for k in channels:
            pulled = abs(stiffness[k]) / (1.0 - (wanted.response_at_rest or 0.0))
            needed = pulled if wanted.stiffness is None else wanted.stiffness + abs(stiffness[k])
            found = max(found, float(np.sqrt(needed / point.inertia[k, k])))
    return found / (2 * np.pi * wanted.bandwidth_hz)


def _settings(
    points: Sequence[OperatingPoint],
    wanted: Requirements,
    law: SampledLaw,
    channels: Sequence[int],
    natural: float,
    damping: float,
) -> Tracking:
    """Return settings with gains or weights of some joints, each for its mean inertia.

    They give a natural frequency (in required bandwidths) and a damping ratio.
    """
    omega, joints = 2 * np.pi * wanted.bandwidth_hz * natural, points[0].mechanism.independent_joints
    inertia = [float(np.exp(np.mean([np.log(point.inertia[k, k]) for point in points]))) for k in channels]
    settings = law.settings
    if law.by_errors:
        return _with_weights(points, settings, channels[0], inertia[0], omega, damping)
    names = [joints[k].name for k in channels]
    kp = {name: own * omega**2 for name, own in zip(names, inertia, strict=True)}
    kd = {name: 2 * damping * own * omega for name, own in zip(names, inertia, strict=True)}
    if isinstance(settings.kp, Mapping) and isinstance(settings.kd, Mapping):
        return settings.replace(kp={**settings.kp, **kp}, kd={**settings.kd, **kd})
    return settings.replace(kp=kp[names[0]], kd=kd[names[0]])


def _with_weights(points, settings: Tracking, channel: int, inertia: float, omega: float, damping: float) -> Tracking:
    """Return settings with the LQR weights of a single joint that give a natural frequency [rad/s] and a damping ratio.

    LQR of a double integrator has kp = u / s_w and kd^2 = 2 J kp + (u / v_w)^2, with the weights s_w and v_w.
    """
    kp, kd, joint = inertia * omega**2, 2 * damping * inertia * omega, points[0].mechanism.independent_joints[channel]
    limit = _effort_weight(points, channel)
    # A velocity weight increases LQR's kd above sqrt(2 J kp). If a smaller kd is required, the result is half a percent
    # above it.
    extra = max(kd**2 - 2 * inertia * kp, _LEAST_EXTRA_DAMPING * 2 * inertia * kp)
    position, velocity = (float(np.clip(joint.shown(x), *LQR_ERRORS)) for x in (limit / kp, limit / np.sqrt(extra)))
    return settings.replace(**{f"lqr_position_{joint.unit}": position, f"lqr_velocity_{joint.unit}_s": velocity})


def _effort_weight(points: Sequence[OperatingPoint], channel: int) -> float:
    """Return the joint effort with unit cost in LQR: the actuator's limit through the transmission."""
    actuator = points[0].mechanism.actuators[0]
    limit = max(abs(actuator.lower), abs(actuator.upper))
    limit = limit if np.isfinite(limit) else max(1.0, max(float(np.abs(point.hold[0])) for point in points))
    return limit / abs(float(effort_map(points[0])[0, channel]))


def _shortfalls(points: Sequence[OperatingPoint], candidates: Sequence[SampledLaw], wanted: Requirements) -> np.ndarray:
    """Return the relative shortfall of each candidate (n,), the largest over the points, from approximate margins.

    At a point it is the sum over the joints' loops of each one's largest shortfall.
    """
    total, timing = np.zeros(len(candidates)), candidates[0].timing
    for point in points:
        gains, known = [], np.ones(len(candidates), dtype=bool)
        for i, one in enumerate(candidates):
            try:
                gains.append(law_gain(point, one.name, one.settings, one.effort_limit))
            except LinkplanError:  # LQR without a solution
                gains.append(np.zeros((point.mechanism.n_u, 2 * point.mechanism.dof)))
                known[i] = False
        every = quick_loops(point, np.array(gains), timing, point.mechanism.channels)
        stable = known & (every[0].radius < 1.0)
        short = np.sum([np.maximum(0.0, shortfall(one, wanted, timing, _SEARCH_RESERVE)) for one in every], axis=0)
        total = np.maximum(total, np.where(stable, short, UNSTABLE_SHORTFALL * len(every) + every[0].radius))
    return total
