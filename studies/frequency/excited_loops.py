"""The simulations of a frequency-response measurement: one row for each pair of feedback loop and excitation."""

from collections.abc import Sequence

import numpy as np

from linkplan.studies.frequency.feedback_loops import FeedbackLoop, channel_effort
from linkplan.studies.frequency.simulated_loops import SimulatedLoops


class ExcitedLoops:
    """Simulations (n,) of loops of one mechanism and one timing: every row (loop, excitation) `repeats` times.

    `hold` (n, n_u) [N.m or N] are the holding efforts; `read` (n, n_u) measures the effort where the loop is broken.
    """

    def __init__(
        self,
        loops: Sequence[FeedbackLoop],
        excitations: Sequence[str],
        channel: int,
        effort_limit: np.ndarray,
        repeats: int = 1,
    ) -> None:
        def of_rows(values: list) -> np.ndarray:
            return np.repeat(values, repeats, axis=0)

        self.rows = tuple((loop, excitation) for loop in loops for excitation in excitations)
        points = [loop.point for loop, _ in self.rows]
        efforts = [channel_effort(point, channel) for point in points]
        self._channel, self._state = channel, of_rows([point.state for point in points])
        self.hold, self.read = of_rows([point.hold for point in points]), of_rows([read for read, _ in efforts])
        self._push = of_rows([push for _, push in efforts])
        self._effort = of_rows([excitation == "effort" for _, excitation in self.rows])  # where the test signal is an effort
        mechanism = loops[0].point.mechanism
        self.simulations = SimulatedLoops(
            mechanism,
            pose=of_rows([point.pose for point in points]),
            velocity=self._state[:, mechanism.dof :],
            gain=of_rows([loop.gain for loop, _ in self.rows]),
            under_way=self.hold,
            timing=loops[0].timing,
            effort_limit=effort_limit,
        )

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
        n_s = self._state.shape[1] // 2
        effort = self._effort[active]
        reference = np.repeat(self._state[None, active], len(signal), axis=0)
        reference[:, :, self._channel] += np.where(effort, 0.0, signal)
        reference[:, :, n_s + self._channel] += np.where(effort, 0.0, rate)
        feedforward = self.hold[active] + forward
        feedforward += np.where(effort, signal, 0.0)[:, :, None] * self._push[active]
        x, commands = self.simulations.run(active, reference, feedforward)
        command = np.sum((commands - self.hold[active]) * self.read[active], axis=2)
        return command, x[:, :, self._channel] - self._state[active, self._channel], commands
