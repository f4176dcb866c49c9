"""One law for a motion in phases: that of the present phase, which changes at measured contacts.

A phase that ends with a touch-down ends when its contacts are measured, at most a share of its duration early or late.
Another one ends as planned: a release follows from the law's efforts. A gait begins again after its last phase, perhaps with
its legs exchanged.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.tracker import TrackerWithMemory

# How early or late the contacts of the next phase may be, as a share of a phase's duration.
WINDOW_SHARE = 0.2


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Stage:
    """The law of one phase.

    Args:
        law: the tracker.
        reference: the motion at the control instants of the phase.
        independent: (n_s,) the joints whose positions and rates the law measures.
        touching: (n_feet,) the feet that must touch the ground before the next phase begins.
    """

    law: TrackerWithMemory
    reference: SampledReference
    independent: np.ndarray
    touching: np.ndarray

    @property
    def window(self) -> int:
        """The number of control instants by which the phase may end early or late."""
        return int(np.ceil(WINDOW_SHARE * self.reference.n))

    def in_time(self, instants: int) -> bool:
        """Return whether a phase that ended after some instants had its touch-down within the time that is waited for it."""
        return not self.touching.any() or abs(instants - self.reference.n) < self.window

    def ends(self, instants: int, touches: np.ndarray) -> bool:
        """Return whether the phase ends after some instants, with the feet (n_feet,) that touch the ground."""
        n = self.reference.n
        if not self.touching.any():
            return instants >= n
        return instants >= n + self.window or (instants >= n - self.window and bool(touches[self.touching].all()))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Exchanged:
    """How a gait's legs change their parts: the joints, actuators and feet in this order, and the way of the origin.

    `joints` (n_q,), `actuators` (n_u,), `feet` (n_feet,). The origin of the coordinates moves by `moved` (n_q,) each time.
    """

    joints: np.ndarray
    actuators: np.ndarray
    feet: np.ndarray
    moved: np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhasedLaw:
    """A tracker of all joints (n_q,), whose velocities are followed by the feet's normal forces [N].

    Its memory has the number of the phase since the start, that of instants in it, and the memory of the phase's law.
    `exchanged` is that of a gait, which repeats; None for a motion that ends.
    """

    name: str
    stages: tuple[Stage, ...]
    exchanged: Exchanged | None = None
    batched: ClassVar[bool] = True

    def start(self, n: int) -> np.ndarray:
        """Return the memory (n, 2 + m) at the start of the motion."""
        held = [stage.law.start(n) for stage in self.stages]
        memory = np.zeros((n, 2 + max(one.shape[1] for one in held)))
        memory[:, 2 : 2 + held[0].shape[1]] = held[0]
        return memory

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) for poses (n, n_q), their rates and the feet's forces (n, n_q + n_feet), and memory."""
        del k  # a phase's instants are counted from its own beginning
        efforts, after = [], memory.copy()
        for row, (pose, measured) in enumerate(zip(position_rad, velocity_rad_s, strict=True)):
            number, instants = self.next_phase(after[row, 0], after[row, 1], measured[len(pose) :] > 0)
            stage = self.stages[number % len(self.stages)]
            if number != after[row, 0]:
                begun = stage.law.start(1)[0]
                after[row, 2 : 2 + len(begun)] = begun
            q, v = self.seen(number, pose, measured[: len(pose)])
            size = stage.law.start(1).shape[1]
            at = min(instants, stage.reference.n - 1)
            held = after[row : row + 1, 2 : 2 + size]
            u, held = stage.law.step(at, q[None, stage.independent], v[None, stage.independent], held)
            after[row, :2], after[row, 2 : 2 + size] = (number, instants + 1), held[0]
            efforts.append(self._exchanged_order(number, "actuators", u[0]))
        return np.array(efforts), after

    def next_phase(self, number: float, instants: float, touches: np.ndarray) -> tuple[int, int]:
        """Return the phase at an instant and the instants in it, from those before and the feet that touch the ground."""
        number, instants = int(number), int(instants)
        last = self.exchanged is None and number + 1 == len(self.stages)
        stage, seen = self.stages[number % len(self.stages)], self._exchanged_order(number, "feet", touches)
        return (number, instants) if last or not stage.ends(instants, seen) else (number + 1, 0)

    def seen(self, number: int, pose: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose (..., n_q) and the rates in the coordinates of a phase."""
        if self.exchanged is None:
            return pose, rates
        repeated = number // len(self.stages)
        q = self._exchanged_order(number, "joints", pose) - repeated * self.exchanged.moved
        return q, self._exchanged_order(number, "joints", rates)

    def on_in(self, number: int, feet: np.ndarray) -> np.ndarray:
        """Return the machine's feet (n_feet,) that a phase has as its `feet`."""
        odd = self.exchanged is not None and number // len(self.stages) % 2
        return feet[np.argsort(self.exchanged.feet)] if odd else feet

    def _exchanged_order(self, number: int, of: str, values: np.ndarray) -> np.ndarray:
        """Return values of joints, actuators or feet as a phase has them: exchanged in every second repetition."""
        odd = self.exchanged is not None and number // len(self.stages) % 2
        return values[..., getattr(self.exchanged, of)] if odd else values

    def phases_of(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the phases (t,) at control instants and the instants in them, from the feet's forces (t, n_feet)."""
        found, number, instants = [], 0, 0
        for touches in forces > 0:
            number, instants = self.next_phase(number, instants, touches)
            found.append((number, instants))
            instants += 1
        numbers = np.array(found, dtype=int).reshape(-1, 2)
        return numbers[:, 0], numbers[:, 1]
