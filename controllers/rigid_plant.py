"""The plant with rigid kinematic loops: the reduced dynamics are integrated accurately instead of simulated in MuJoCo.

The difference between this plant and `MujocoPlant` shows the effect of MuJoCo's soft closures and integrator. An effort is
held between commands. The reduced dynamics are integrated with fourth-order Runge-Kutta steps, at least two per simulator
step, and a Newton step then closes the loops again. There is no saturation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.controllers.imperfections.driving import arrived, driving, take
from linkplan.controllers.imperfections.imperfections import Drives, Imperfections
from linkplan.controllers.imperfections.plant import start_of
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.sampling import substeps_of
from linkplan.controllers.trackers.prediction import acting, runge_kutta
from linkplan.models.compiled.functions import evaluated, mapped
from linkplan.models.mechanism import Mechanism
from linkplan.models.reduction.closing import MAX_LOOP_GAP_M, corrected, gap_at

LOST = "the rigid loop was driven to where it cannot be closed"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RigidPlant:
    """The nominal mechanism, with rigid loops. Only a machine's clock and start are used."""

    mechanism: Mechanism
    delay_periods: float = 0.0  # of computing, for all machines

    def begin(
        self, reference: SampledReference, machines: Sequence[Imperfections]
    ) -> tuple["RigidStepper", list[str | None]]:
        """Return the machines at the start of a reference, and for each the error None, because all can be built."""
        return RigidStepper(self, reference, machines), [None] * len(machines)


class RigidStepper:
    """Rigid machines, advanced one control period at a time; see `Stepper`."""

    independent: np.ndarray | slice
    lost = LOST

    def __init__(self, plant: RigidPlant, reference: SampledReference, machines: Sequence[Imperfections]) -> None:
        mechanism, clocks = plant.mechanism, [one.clock for one in machines]
        self.n, self.n_u = len(machines), mechanism.n_u
        self.running = np.ones(self.n, dtype=bool)
        self.independent, self.n_q, self.n_s = mechanism.independent, mechanism.n_q, mechanism.dof
        self._periods = reference.period_s * np.array([clock.period_factor for clock in clocks])
        delays = [plant.delay_periods + clock.delay_periods for clock in clocks]
        unlimited = np.tile([-np.inf, np.inf], (mechanism.n_u, 1))
        # With one simulator step per period, the drives return a delay's remainder as a fraction of a period.
        self._drives = driving([Drives()] * self.n, delays, self._periods, 1, unlimited)
        data = mujoco.MjData(mechanism.model)
        starts = [start_of(mechanism.model, data, mechanism, reference, one) for one in machines]
        self._start = np.array([np.concatenate([pose, rates[mechanism.independent]]) for pose, rates in starts])
        self._state = self._start.copy()
        self.timestep_s = float(mechanism.model.opt.timestep) * np.ones(self.n)
        self._onward = mapped(_onward(mechanism, substeps_of(mechanism, 2 * self._periods.max())), self.n)
        self._k, self._mechanism = 0, mechanism
        self._begun = np.array([clock.phase_periods for clock in clocks])

    def read(self, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Write the machines' poses and velocities."""
        pose[...], velocity[...] = self._state[:, : self.n_q], self._state[:, self.n_q :]

    def share(self, pose: np.ndarray, command: np.ndarray) -> np.ndarray:  # noqa: ARG002
        """Return the commands: there are no limits."""
        return command

    def hold(self, command: np.ndarray, applied: np.ndarray, speed: np.ndarray) -> None:
        """Advance the machines by a period; the actuators' speeds are not computed."""
        take(self._drives, self._k, command)
        before, now = arrived(self._drives, self._k - 1), arrived(self._drives, self._k)
        share, gap, state = self._drives.fraction, np.zeros(self.n), self._state
        for effort, begin, part in ((before, 0.0 * share, share), (now, share, 1.0 - share)):
            if np.any(part):
                middle_s = (self._begun + self._k + begin + 0.5 * part) * self._periods
                held = np.hstack([effort, *self._mechanism.forces_at(middle_s)])
                after, opened = evaluated(self._onward, state.T, held.T, part * self._periods)
                state, gap = after.T, np.maximum(gap, opened.ravel())
        # A larger gap means that the mechanism was driven beyond the poses where its loop closes.
        lost = ~((gap <= MAX_LOOP_GAP_M) & np.isfinite(state).all(axis=1))
        self._state = np.where(lost[:, None], np.nan, state)
        self._state[~self.running] = self._start[~self.running]
        self._k += 1
        applied[...] = share[:, None] * before + (1.0 - share)[:, None] * now
        speed[...] = np.nan

    def freeze(self, lost: np.ndarray) -> None:
        """Put the machines of a mask (n,) back to their starts, where they stay."""
        self.running = self.running & ~lost
        self._state[lost] = self._start[lost]

    def gap_and_contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Return zero gaps and contacts (n,)."""
        return np.zeros(self.n), np.zeros(self.n, dtype=int)


def _onward(mechanism: Mechanism, steps: int) -> ca.Function:
    """Return the function ((q, v), what acts (`acting`), duration [s]) -> final (q, v), loop gap [m]."""
    dynamics, n_q = mechanism.dynamics, mechanism.n_q
    state, u = ca.MX.sym("state", n_q + mechanism.dof), acting(mechanism)
    duration = ca.MX.sym("duration")
    one = ca.Function("one", [state, u, duration], [runge_kutta(mechanism, state, u, duration / steps)])
    x = state
    for _ in range(steps):
        x = one(x, u, duration)
    q = corrected(dynamics, x[:n_q], 1)
    return ca.Function("onward", [state, u, duration], [ca.vertcat(q, x[n_q:]), gap_at(dynamics, q)])
