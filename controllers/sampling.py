"""Sampling of a control law: control period, simulator steps within it, and computing delay.

A command computed from the state at t_k = k T acts from t_k + delay and is held for one period:

    x_{k+1} = A x_k + B_late u_{k-d-1} + B u_{k-d}

The delay has d whole periods. B_late belongs to the part of a period in which the previous command still acts.
"""

from dataclasses import dataclass

import numpy as np

from linkplan.controllers.integrator import repeat, simulator_step
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism

# Longest delay of a margin: no practical feedback loop has a longer one.
MOST_DELAY_PERIODS = 1000
# A delay this close to a whole number of simulator steps is rounded to it.
_STEP_TOLERANCE = 1e-6
# Most simulator steps in one control period: no practical feedback loop has more.
MOST_SUBSTEPS = 100_000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Sampling:
    """A control period [s] of `substeps` simulator steps, and a computing delay of `delay_steps` simulator steps."""

    period_s: float
    substeps: int = 1
    delay_steps: int = 0

    @property
    def timestep_s(self) -> float:
        """The simulator's step [s]."""
        return self.period_s / self.substeps

    @property
    def delay_s(self) -> float:
        """The computing delay [s]."""
        return self.delay_steps * self.timestep_s

    @property
    def whole(self) -> int:
        """The number d of whole periods in the delay."""
        return self.delay_steps // self.substeps

    @property
    def late(self) -> int:
        """The simulator steps of a period in which the previous command still acts."""
        return self.delay_steps % self.substeps

    @property
    def memory(self) -> int:
        """The number of past commands that the loop's state holds."""
        return self.whole + (self.late > 0)

    @property
    def nyquist_hz(self) -> float:
        """Half the sampling rate [Hz]."""
        return 0.5 / self.period_s


def sampling(mechanism: Mechanism, period_s: float, delay_periods: float = 0.0) -> Sampling:
    """Return the sampling of a control period [s] with the fewest simulator steps.

    Args:
        mechanism: its model's timestep is the longest simulator step.
        period_s: the control period [s].
        delay_periods: computing delay in control periods; for a fraction the number of simulator steps is increased until
            the delay is a whole number of them.

    Raises:
        LinkplanError: for a period of too many simulator steps, or a delay between two of them.
    """
    if period_s > MOST_SUBSTEPS * float(mechanism.model.opt.timestep):
        raise LinkplanError(
            f"a control period of {period_s:g} s is {period_s / float(mechanism.model.opt.timestep):.3g} simulator steps; at"
            f" most {MOST_SUBSTEPS} are run"
        )
    fewest = substeps_of(mechanism, period_s)
    for n in range(fewest, 20 * fewest + 1):
        if abs(delay_periods * n - round(delay_periods * n)) < _STEP_TOLERANCE:
            return Sampling(period_s=period_s, substeps=n, delay_steps=round(delay_periods * n))
    raise LinkplanError(
        f"a delay of {delay_periods:g} control periods is not a whole number of simulator steps: a period has at most"
        f" {20 * fewest} of them"
    )


def substeps_of(mechanism: Mechanism, period_s: float) -> int:
    """Return the number of simulator steps of a control period [s], none longer than the model's own step."""
    return max(1, int(np.ceil(period_s / float(mechanism.model.opt.timestep) - 1e-9)))


def simulated(
    mechanism: Mechanism, pose: np.ndarray, velocity: np.ndarray, effort: np.ndarray, timing: Sampling, *forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A (n, m, m), B and B_late (n, m, n_u) of a period in MuJoCo's own steps, linearised about states (n, ...).

    `forces` are those of `linearise`.
    """
    A_h, B_h = simulator_step(mechanism, pose, velocity, effort, timing.timestep_s, *forces)
    A, B = repeat(A_h, B_h, timing.substeps)
    new = repeat(A_h, B_h, timing.substeps - timing.late)[1]
    return A, new, B - new


def held_over(A: np.ndarray, B: np.ndarray, timing: Sampling) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B and B_late of a period of x' = A x + B u (m, m) and (m, n_u) under held commands, without a simulator.

    The exponential of [[A, B], [0, 0]] h has the exact maps of a step h (Van Loan, IEEE Trans. Autom. Control 23, 1978).
    """
    import scipy

    m, n_u = B.shape
    block = scipy.linalg.expm(timing.timestep_s * np.block([[A, B], [np.zeros((n_u, m + n_u))]]))
    A_T, B_T = repeat(block[:m, :m], block[:m, m:], timing.substeps)
    new = repeat(block[:m, :m], block[:m, m:], timing.substeps - timing.late)[1]
    return A_T, new, B_T - new


def augmented(A: np.ndarray, B: np.ndarray, B_late: np.ndarray, timing: Sampling) -> tuple[np.ndarray, np.ndarray]:
    """Return A (..., M, M) and B (..., M, n_u) for the state (x, u_{k-1}, ..., u_{k-memory}) and the input u_k."""
    m, n_u = B.shape[-2:]
    p = timing.memory
    size = m + p * n_u
    A_all, B_all = np.zeros((*A.shape[:-2], size, size)), np.zeros((*A.shape[:-2], size, n_u))
    A_all[..., :m, :m] = A
    columns = [slice(m + i * n_u, m + (i + 1) * n_u) for i in range(p)]
    if p:
        B_all[..., columns[0], :] = np.eye(n_u)
    for i in range(1, p):
        A_all[..., columns[i], columns[i - 1]] = np.eye(n_u)
    if timing.whole == 0:
        B_all[..., :m, :] = B
    else:
        A_all[..., :m, columns[timing.whole - 1]] = B
    if timing.late:
        A_all[..., :m, columns[timing.whole]] = B_late
    return A_all, B_all


def closed(A: np.ndarray, B: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Return the closed loop's matrix A - B [K 0] (..., M, M) for gains K (..., n_u, m) on the measured state."""
    full = np.zeros((*np.broadcast_shapes(gain.shape[:-2], A.shape[:-2]), gain.shape[-2], A.shape[-1]))
    full[..., : gain.shape[-1]] = gain
    return A - B @ full


def spectral_radius(matrix: np.ndarray) -> np.ndarray:
    """Return the spectral radius (...,) of matrices (..., M, M); a loop is stable below one."""
    return np.abs(np.linalg.eigvals(matrix)).max(axis=-1)
