"""Responses of a plant from efforts to positions, measured in MuJoCo by a sinestream, in a feedback loop or without one.

For each actuator there is one set of simulations, in which the test signal is added to its command. With the commands U
(n_u, n_u) and the positions Y (n_y, n_u) of these sets, one in a column, the plant is

    Y = G U,   G = Y U^-1

(Pintelon & Schoukens, System Identification, 2012). With one actuator G is the ratio of position to command. The loop that
holds the plant at its point does not change G, because U are the commands including the loop's part.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from linkplan.models.tree.joints import unit_steps
from linkplan.studies.feedback.frequency.excitation import (
    EFFORT_SHARE,
    MOTION_AMPLITUDE_RAD,
    Measurement,
    Setup,
    measured_response,
    whole_samples,
)
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop
from linkplan.studies.feedback.frequency.ports import PlantInput, PlantOutput, gain_unit, pair_name
from linkplan.studies.feedback.frequency.simulated_loops import Excitation, ExcitedLoops
from linkplan.studies.feedback.frequency.sinestream import refuse_many, settled_phasors

# Signals smaller than this share of the largest of their kind need not settle, because their errors hardly change G.
_SMALL_SHARE = 1e-3
# A response settles to 1e-4 within this many time constants of its slowest pole. A measurement waits that long if all its
# simulations together then take at most this time [s]; otherwise it waits as long as measurements of loops do.
_SETTLING_DECAYS, _LONGEST_S = 9.0, 60.0


def measure_plants(
    loops: Sequence[FeedbackLoop],
    inputs: Sequence[PlantInput],
    outputs: Sequence[PlantOutput],
    frequency_hz: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup,
    say: Callable[[str], None],
) -> Measurement:
    """Return the responses from inputs to outputs, by `pair_name`, of the plants in stable loops of one mechanism.

    Args:
        loops: sampled, with their points; with zero gains the plant is measured in open loop.
        inputs: efforts.
        outputs: positions that some actuator moves.
        frequency_hz: (n,), shifted so that whole cycles take whole samples.
        effort_limit: of the actuators (n_u, 2) [N.m or N].
        setup: the settings of the measurement.
        say: receives progress messages.

    Raises:
        LinkplanError: for frequencies above the Nyquist frequency, or windows that are too long to store.
    """
    timing, n_u = loops[0].timing, len(effort_limit)
    cycles, samples = whole_samples(frequency_hz, timing.period_s)
    frequency = cycles / (samples * timing.period_s)
    refuse_many(samples, frequency, len(loops) * n_u)
    rows = [Excitation(loop=loop, push=of_one, read=of_one) for loop in loops for of_one in np.eye(n_u)]

    def measured(poses: np.ndarray, added: np.ndarray) -> np.ndarray:
        return np.column_stack([*(output.at_poses(poses) for output in outputs), added])

    excited = ExcitedLoops(rows, measured, effort_limit, len(frequency))
    amplitudes, floors = zip(*(_sizes(loop, outputs, frequency, effort_limit, setup) for loop in loops), strict=True)
    slowest = _SETTLING_DECAYS * max(map(decay_time_s, loops))
    if setup.longest_s < slowest <= _LONGEST_S / (len(loops) * n_u):
        setup = replace(setup, longest_s=slowest)
    taken = settled_phasors(
        excited, cycles, samples, np.concatenate(amplitudes), effort_limit, setup, say, floors=np.concatenate(floors)
    )
    found = []
    for place, loop in enumerate(loops):
        own = range(place * n_u, (place + 1) * n_u)
        signals = np.moveaxis(taken.phasors[own.start : own.stop, :, :, 3:], 0, -1)  # (windows, n, n_y + n_u, n_u)
        Y, U = signals[:, :, : len(outputs)], signals[:, :, len(outputs) :]
        G = np.swapaxes(np.linalg.solve(np.swapaxes(U, 2, 3), np.swapaxes(Y, 2, 3)), 2, 3)
        quality = _worst([taken.quality(row) for row in own])
        responses = {}
        for one in inputs:
            push = one.push(loop.point)
            for k, output in enumerate(outputs):
                found_gain = G[:, :, k] @ push, gain_unit(one, output)
                responses[pair_name(one, output)] = measured_response(frequency, *found_gain, "effort", quality)
        found.append(responses)
    steps = taken.simulated_periods * timing.substeps
    return Measurement(responses=tuple(found), simulated_steps=steps, conditions=excited.simulations.conditions())


def decay_time_s(loop: FeedbackLoop) -> float:
    """Return the time [s] in which the slowest pole of a stable sampled loop decays by e."""
    return float(-loop.timing.period_s / np.log(max(loop.radius or 0.0, 1e-300)))


def sampled_gains(loop: FeedbackLoop, push: np.ndarray, row: np.ndarray, frequency_hz: np.ndarray) -> np.ndarray:
    """Return the gains (n,) from an effort to an output of the sampled plant, with hold, delay and MuJoCo's steps."""
    return row @ loop.plant(frequency_hz)[:, : len(row)] @ push


def _sizes(
    loop: FeedbackLoop, outputs: Sequence[PlantOutput], frequency_hz: np.ndarray, effort_limit: np.ndarray, setup: Setup
) -> tuple[np.ndarray, np.ndarray]:
    """Return the amplitudes (n_u, n) of the test signals, and the `floors` (n_u, n, signals) of `settled_phasors`.

    A test signal moves each coordinate little and does not saturate an actuator.
    """
    mechanism, n_u = loop.point.mechanism, len(effort_limit)
    actuated = mechanism.actuated
    units = unit_steps(mechanism.joints, mechanism.extent_m)[mechanism.independent][actuated]
    G = loop.plant(frequency_hz)
    U = np.linalg.inv(np.eye(n_u) + loop.gain @ G)  # (n, n_u, n_u): commands for unit signals, one actuator's in a column
    X = (G @ U)[:, : mechanism.dof]
    wanted = MOTION_AMPLITUDE_RAD * units if setup.amplitude is None else np.full(len(units), setup.amplitude)
    room = np.min(np.abs(effort_limit - loop.point.hold[:, None]), axis=1)
    room = np.full(n_u, np.inf) if setup.amplitude is not None else EFFORT_SHARE * room
    with np.errstate(divide="ignore", invalid="ignore"):
        moves = np.min(wanted[:, None] / np.abs(X[:, actuated]), axis=1)
        amplitude = np.minimum(moves, np.min(room[:, None] / np.abs(U), axis=1)).T
    Y = np.stack([output.slopes(loop.point.pose) for output in outputs]) @ X
    largest = [np.max(amplitude.T[:, None] * np.abs(of), axis=2) for of in (Y, U)]  # (n, n_y), (n, n_u)
    commands = np.broadcast_to(largest[1].max(axis=1, keepdims=True), largest[1].shape)
    small = _SMALL_SHARE * np.concatenate([np.zeros((len(Y), 3)), largest[0], commands], axis=1)
    return amplitude, np.broadcast_to(small, (n_u, *small.shape))


def _worst(qualities: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the worst quality at each frequency."""
    return {
        name: (np.min if name == "coherence" else np.max)([one[name] for one in qualities], axis=0) for name in qualities[0]
    }
