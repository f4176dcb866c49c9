"""Where the integration of an unstable motion is restarted from its planned state.

Along an unstable motion an error grows by many orders of magnitude, and after some seconds rounding alone decides where it
ends. What is judged then, as for mechanisms, is whether the solution is a motion of the differential equation, and not
whether somebody could follow it blindly.
"""

import numpy as np
from scipy.linalg import expm

from linkplan.planner.certificate.integration import GROWTH
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory

# Steps in each interval over which the Jacobian is held: growth is to be known to its order of magnitude.
_STEPS = 4


def restarts_of(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray) -> np.ndarray:
    """Return at which intervals' beginnings (n,) integration is restarted: before an error would have grown by `GROWTH`.

    Args:
        problem: whose f gives the growth, by the product of exp(df/dx h).
        trajectory: the motion.
        size: (n_x,) of its states, in which errors are measured.
    """
    n, n_x = len(trajectory.breaks_s) - 1, problem.n_x
    time = trajectory.times_at((np.arange(_STEPS) + 0.5) / _STEPS)
    p = np.tile(problem.parameters[:, None], (1, len(time)))
    x, u = trajectory.state_at(time).T, trajectory.effort_at(time).T
    jacobian = problem.at_instant("rate").jacobian().map(len(time))
    columns = np.array(jacobian(x, u, p, time[None], np.zeros((n_x, len(time))))[0])
    widths, carried, restarted = np.diff(trajectory.breaks_s) / _STEPS, np.eye(n_x), np.zeros(n, dtype=bool)
    for k in range(n):
        across = np.eye(n_x)
        for i in range(k * _STEPS, (k + 1) * _STEPS):
            rate = columns[:, i * n_x : (i + 1) * n_x] * size / size[:, None]
            across = expm(rate * widths[k]) @ across
        carried = across @ carried
        if k and np.abs(carried).max() > GROWTH:
            carried, restarted[k] = across, True
    return restarted
