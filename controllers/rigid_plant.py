"""The feedback loop on rigid kinematic loops: the reduced dynamics, integrated tightly, in the simulator's place.

What MuJoCo adds to a run, soft closures and its integrator's step, is the difference between this plant and `MujocoPlant`.
An effort is held from one command to the next; in between the reduced dynamics go on by Runge-Kutta steps of fourth order,
at least two to a step of the simulator, and a Newton step closes the loops again at the end. Nothing saturates here.
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
from linkplan.controllers.trackers.prediction import runge_kutta
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, mapped

# Steps of the integrator in one of the simulator's.
_FINER = 2
# A loop that is open by more than this [m] after a Newton step has been driven through a pose where it cannot close.
_CLOSED_M = 1e-6
LOST = "the rigid loop was driven to where it cannot be closed"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RigidPlant:
    """A mechanism as modelled, its loops rigid. Of a machine's imperfections it has the clock and the start."""

    mechanism: Mechanism
    delay_periods: float = 0.0  # of computing, for all machines

    def begin(
        self, reference: SampledReference, machines: Sequence[Imperfections]
    ) -> tuple["RigidStepper", list[str | None]]:
        """Return the machines at the start of a reference; each can be built."""
        return RigidStepper(self, reference, machines), [None] * len(machines)


class RigidStepper:
    """Rigid machines that are moved on by control periods; see `Stepper`."""

    lost = LOST

    def __init__(self, plant: RigidPlant, reference: SampledReference, machines: Sequence[Imperfections]) -> None:
        mechanism, clocks = plant.mechanism, [one.clock for one in machines]
        self.n, self.n_u, self.rows = len(machines), mechanism.n_u, slice(None)
        self.independent, self.n_q, self.n_s = mechanism.independent, mechanism.n_q, mechanism.dof
        self._periods = reference.period_s * np.array([clock.period_factor for clock in clocks])
        delays = [plant.delay_periods + clock.delay_periods for clock in clocks]
        unlimited = np.tile([-np.inf, np.inf], (mechanism.n_u, 1))
        # A simulator step is a whole period here: what is left of a delay is a fraction of one.
        self._drives = driving([Drives()] * self.n, delays, self._periods, 1, unlimited)
        data = mujoco.MjData(mechanism.model)
        starts = [start_of(mechanism.model, data, mechanism, reference, one) for one in machines]
        self._start = np.array([np.concatenate([pose, rates[mechanism.independent]]) for pose, rates in starts])
        self._state = self._start.copy()
        self.timestep_s = float(mechanism.model.opt.timestep) * np.ones(self.n)
        steps = max(1, int(np.ceil(_FINER * self._periods.max() / float(mechanism.model.opt.timestep) - 1e-9)))
        self._onward = mapped(_onward(mechanism, steps), self.n)
        self._k = 0

    def read(self, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Fill in poses and velocities of the machines that run."""
        state = self._state[self.rows]
        pose[...], velocity[...] = state[:, : self.n_q], state[:, self.n_q :]

    def hold(self, command: np.ndarray, applied: np.ndarray, speed: np.ndarray) -> None:
        """Move the machines on by a period; actuators' speeds are not known here."""
        commands = np.zeros((self.n, self.n_u))
        commands[self.rows] = command
        take(self._drives, self._k, commands)
        before, acting = arrived(self._drives, self._k - 1), arrived(self._drives, self._k)
        share, gap, state = self._drives.fraction, np.zeros(self.n), self._state
        for effort, duration in ((before, share * self._periods), (acting, (1.0 - share) * self._periods)):
            if np.any(duration):
                after, opened = evaluated(self._onward, state.T, effort.T, duration)
                state, gap = after.T, np.maximum(gap, opened.ravel())
        lost = ~((gap <= _CLOSED_M) & np.isfinite(state).all(axis=1))
        # A frozen machine stays at its start, where the dynamics can be evaluated beside the others'.
        self._state = self._start.copy()
        self._state[self.rows] = np.where(lost[:, None], np.nan, state)[self.rows]
        self._k += 1
        applied[...] = (share[:, None] * before + (1.0 - share)[:, None] * acting)[self.rows]
        speed[...] = np.nan

    def keep(self, running: np.ndarray) -> None:
        """Freeze all but some of the machines that run."""
        self.rows = np.arange(self.n)[self.rows][running]
        frozen = np.setdiff1d(np.arange(self.n), self.rows)
        self._state[frozen] = self._start[frozen]

    def gap_and_contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Return no gap and no contacts (n,) of any machine."""
        return np.zeros(self.n), np.zeros(self.n, dtype=int)


def _onward(mechanism: Mechanism, steps: int) -> ca.Function:
    """Return ((q, v), efforts, duration [s]) -> (q, v) after it, and what the loops are open by then [m]."""
    dynamics, n_q = mechanism.dynamics, mechanism.n_q
    state, u = ca.MX.sym("state", n_q + mechanism.dof), ca.MX.sym("u", mechanism.n_u)
    duration = ca.MX.sym("duration")
    one = ca.Function("one", [state, u, duration], [runge_kutta(mechanism, state, u, duration / steps)])
    x = state
    for _ in range(steps):
        x = one(x, u, duration)
    q, gap = x[:n_q], ca.MX(0)
    dependent = mechanism.dependent.tolist()
    if dependent:
        q[dependent] += dynamics.closure_step(q)[1]
        gap = ca.norm_inf(dynamics.independent_closure(q))
    return ca.Function("onward", [state, u, duration], [ca.vertcat(q, x[n_q:]), gap])
