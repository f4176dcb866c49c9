"""Responses of a plant from efforts to positions, measured in MuJoCo by a sinestream, in a feedback loop or without one.

For each actuator there is one set of simulations, in which the test signal is added to its command. With the commands U
(n_u, n_u) and the positions Y (n_y, n_u) of these sets, one in a column, the plant is

    Y = G U,   G = Y U^-1

(Pintelon & Schoukens, System Identification, 2012). With one actuator G is the ratio of position to command. The loop that
holds the plant at its point does not change G, because U are the commands with what the loop adds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.tree.joints import unit_steps
from linkplan.studies.feedback.frequency.excitation import EFFORT_SHARE, MOTION_AMPLITUDE_RAD, Setup, whole_samples
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop
from linkplan.studies.feedback.frequency.ports import PlantInput, PlantOutput, gain_unit
from linkplan.studies.feedback.frequency.response import Response
from linkplan.studies.feedback.frequency.simulated_loops import simulated
from linkplan.studies.feedback.frequency.sinestream import refuse_many, settled_phasors

# Signals smaller than this share of the largest of their kind need not settle: their errors change G as little.
_SMALL_SHARE = 1e-3
# A response settles to 1e-4 within this many time constants of its slowest pole. A measurement waits that long if all its
# simulations together then take at most this time [s]; otherwise it waits as long as measurements of loops do.
_SETTLING_DECAYS, _LONGEST_S = 9.0, 60.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MeasuredPlants:
    """The responses of each plant by input and output, the number of simulated steps, and the simulation settings."""

    responses: tuple[dict[tuple[str, str], Response], ...]
    simulated_steps: int
    conditions: dict


class ExcitedPlants:
    """Simulations of held plants: rows (loop, actuator), each at every frequency in turn; see `sinestream.Excited`.

    It measures the outputs, relative to the operating point, and the commands of all actuators, relative to the efforts
    that hold it.
    """

    def __init__(
        self, loops: Sequence[FeedbackLoop], outputs: Sequence[PlantOutput], effort_limit: np.ndarray, repeats: int
    ) -> None:
        def of_rows(values: list) -> np.ndarray:
            return np.repeat(values, repeats, axis=0)

        mechanism = loops[0].point.mechanism
        self.rows = tuple((loop, k) for loop in loops for k in range(mechanism.n_u))
        points = [loop.point for loop, _ in self.rows]
        self._positions = tuple(outputs)
        self.outputs = (*outputs, *mechanism.actuators)
        self.hold = of_rows([point.hold for point in points])
        self.read = of_rows([np.eye(mechanism.n_u)[k] for _, k in self.rows])
        self._state = of_rows([point.state for point in points])
        self._rest = np.stack([output.at_poses(of_rows([point.pose for point in points])) for output in outputs], axis=1)
        self.simulations = simulated([loop for loop, _ in self.rows], effort_limit, repeats)

    def run(
        self, active: np.ndarray, signal: np.ndarray, rate: np.ndarray, forward: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Apply test signals (t, r) [N.m or N] for t control periods; `rate` and `forward` belong to references.

        Returns:
            The command (t, r) of the row's actuator, outputs and commands (t, r, n_y + n_u) relative to the operating
            point, and all commands (t, r, n_u).
        """
        del rate
        feedforward = self.hold[active] + forward + signal[:, :, None] * self.read[active]
        reference = np.repeat(self._state[None, active], len(signal), axis=0)
        pose, _, commands = self.simulations.run_poses(active, reference, feedforward)
        flat, size = pose.reshape(-1, pose.shape[2]), pose.shape[:2]
        places = np.stack([output.at_poses(flat).reshape(size) for output in self._positions], axis=2)
        added = commands - self.hold[active]
        return np.sum(added * self.read[active], axis=2), np.dstack([places - self._rest[active], added]), commands


def measure_plants(
    loops: Sequence[FeedbackLoop],
    inputs: Sequence[PlantInput],
    outputs: Sequence[PlantOutput],
    frequency_hz: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup,
    say: Callable[[str], None],
) -> MeasuredPlants:
    """Return the responses from inputs to outputs of the plants in stable loops of one mechanism and one timing.

    Args:
        loops: sampled, with their points; gains of zero leave a plant to itself.
        inputs: efforts.
        outputs: positions that some actuator moves.
        frequency_hz: (n,), moved so that a period has whole samples.
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
    excited = ExcitedPlants(loops, outputs, effort_limit, len(frequency))
    amplitudes, floors = zip(*(_sizes(loop, outputs, frequency, effort_limit, setup) for loop in loops), strict=True)
    slowest = _SETTLING_DECAYS * max(map(decay_time_s, loops))
    if setup.longest_s < slowest <= _LONGEST_S / (len(loops) * n_u):
        setup = replace(setup, longest_s=slowest)
    taken = settled_phasors(
        excited, cycles, samples, np.concatenate(amplitudes), effort_limit, setup, say, floors=np.concatenate(floors)
    )
    found = []
    for place, loop in enumerate(loops):
        rows = range(place * n_u, (place + 1) * n_u)
        signals = np.moveaxis(taken.phasors[rows.start : rows.stop, :, :, 3:], 0, -1)  # (windows, n, n_y + n_u, n_u)
        Y, U = signals[:, :, : len(outputs)], signals[:, :, len(outputs) :]
        G = np.swapaxes(np.linalg.solve(np.swapaxes(U, 2, 3), np.swapaxes(Y, 2, 3)), 2, 3)
        quality = _worst([taken.quality(row) for row in rows])
        responses = {}
        for one in inputs:
            push = one.push(loop.point)
            for k, output in enumerate(outputs):
                estimates = G[:, :, k] @ push
                spread = np.sqrt(np.mean(np.abs(estimates - estimates.mean(axis=0)) ** 2, axis=0) / (len(estimates) - 1))
                responses[one.name, output.name] = Response(
                    frequency_hz=frequency,
                    gain=estimates.mean(axis=0),
                    unit=gain_unit(one, output),
                    origin="measured in MuJoCo, sinestream, effort",
                    uncertainty=spread,
                    **quality,
                )
        found.append(responses)
    steps = taken.simulated_periods * timing.substeps
    return MeasuredPlants(responses=tuple(found), simulated_steps=steps, conditions=excited.simulations.conditions())


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
