"""The simulations of a frequency-response measurement: one row for each pair of feedback loop and excitation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.studies.frequency.feedback_loops import FeedbackLoop, channel_effort
from linkplan.studies.frequency.simulated_loops import SimulatedLoops


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ExcitedLoops:
    """Simulations (n,): every row (loop, excitation) repeated n / rows times.

    `state` (n, 2 n_s) and `hold` (n, n_u) describe the operating points. `read` and `push` (n, n_u) measure and apply the
    effort at which the channel's loop is broken. `effort` (n,) is true where the test signal is an effort.
    """

    rows: tuple[tuple[FeedbackLoop, str], ...]
    channel: int
    state: np.ndarray
    hold: np.ndarray
    read: np.ndarray
    push: np.ndarray
    effort: np.ndarray
    simulations: SimulatedLoops

    def run(
        self, active: np.ndarray, signal: np.ndarray, rate: np.ndarray, forward: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Apply test signals for t control periods.

        Args:
            active: indices (r,) of the simulations.
            signal: test signal (t, r) [rad, m, N.m or N].
            rate: derivative (t, r) of a reference signal [per second]; effort signals ignore it.
            forward: feedforward efforts (t, r, n_u) in addition to the holding efforts [N.m or N].

        Returns:
            The command (t, r) and the position (t, r) of the channel, both relative to the operating point, and all
            commands (t, r, n_u).
        """
        n_s = self.state.shape[1] // 2
        effort = self.effort[active]
        reference = np.repeat(self.state[None, active], len(signal), axis=0)
        reference[:, :, self.channel] += np.where(effort, 0.0, signal)
        reference[:, :, n_s + self.channel] += np.where(effort, 0.0, rate)
        feedforward = self.hold[active] + forward
        feedforward += np.where(effort, signal, 0.0)[:, :, None] * self.push[active]
        x, commands = self.simulations.run(active, reference, feedforward)
        command = np.sum((commands - self.hold[active]) * self.read[active], axis=2)
        return command, x[:, :, self.channel] - self.state[active, self.channel], commands


def excited_loops(
    loops: Sequence[FeedbackLoop], excitations: Sequence[str], channel: int, effort_limit: np.ndarray, *, repeats: int = 1
) -> ExcitedLoops:
    """Return the simulations of loops of one mechanism and one timing, each (loop, excitation) repeated."""
    rows = tuple((loop, excitation) for loop in loops for excitation in excitations)

    def of_rows(values: list) -> np.ndarray:
        return np.repeat(values, repeats, axis=0)

    efforts = [channel_effort(loop.point, channel) for loop, _ in rows]
    state, hold = of_rows([loop.point.state for loop, _ in rows]), of_rows([loop.point.hold for loop, _ in rows])
    mechanism = loops[0].point.mechanism
    return ExcitedLoops(
        rows=rows,
        channel=channel,
        state=state,
        hold=hold,
        read=of_rows([read for read, _ in efforts]),
        push=of_rows([push for _, push in efforts]),
        effort=of_rows([excitation == "effort" for _, excitation in rows]),
        simulations=SimulatedLoops(
            mechanism,
            pose=of_rows([loop.point.pose for loop, _ in rows]),
            velocity=state[:, mechanism.dof :],
            gain=of_rows([loop.gain for loop, _ in rows]),
            under_way=hold,
            timing=loops[0].timing,
            effort_limit=effort_limit,
        ),
    )
