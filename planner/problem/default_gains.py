"""The default gains of tracking: those of a mass with the machine's inertia, as fast as its control period permits."""

from collections.abc import Callable, Mapping

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import felt_inertia
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import Tracking


def tracking_of(problem: Problem) -> Tracking:
    """Return the settings of a problem's tracking with all gains, its own ones or the default ones."""
    return with_gains(problem.tracking, problem.mechanism, problem.start_pose)


def with_gains(settings: Tracking, mechanism: Mechanism, pose: Callable[[], np.ndarray]) -> Tracking:
    """Return settings with kp and kd: those that are None become J w^2 and 2 zeta w J with the inertia J at a pose.

    w is the smaller one of `bandwidth_hz` and `fastest_feedback`, and zeta is `damping_ratio`. Gains have two digits; those
    of coordinates without actuators are zero. `pose` returns the pose (n_q,), and is called if it is needed.
    """
    if settings.kp is not None and settings.kd is not None:
        return settings
    inertia = np.where(np.isin(np.arange(mechanism.dof), driven_columns(mechanism)), felt_inertia(mechanism, pose()), 0.0)
    frequency = min(2 * np.pi * settings.bandwidth_hz, fastest_feedback(mechanism, settings.period_s))
    gains = {"kp": inertia * frequency**2, "kd": 2 * settings.damping_ratio * frequency * inertia}
    missing = {key: _by_name(mechanism, values) for key, values in gains.items() if getattr(settings, key) is None}
    return settings.replace(**missing)


def driven_columns(mechanism: Mechanism) -> np.ndarray:
    """Return the columns of the independent coordinates on which actuators act, without passive ones."""
    arms = np.abs(np.array(mechanism.dynamics.effort_map(mechanism.home))).max(axis=1, initial=0.0)
    return np.flatnonzero((arms > 1e-9 * arms.max(initial=0.0)) & mechanism.actuated)


def fastest_feedback(mechanism: Mechanism, period_s: float) -> float:
    """Return the largest natural frequency [rad/s] of tracking errors that the simulation of a model permits.

    A PD law sampled with period T is stable up to about kd = 2 J / T; a fifth of that gives omega = 0.2 / T. A soft closure
    with time constant tau (solref, at least two timesteps) has the natural frequency 1 / tau; twice that frequency is
    allowed.
    """
    time_constants = [2 * float(mechanism.model.opt.timestep)]
    for index in dict.fromkeys(closure.index for closure in mechanism.closures):
        first = float(mechanism.model.eq_solref[index, 0])
        time_constants.append(first if first >= 0 else (-first) ** -0.5)  # MuJoCo reads a negative number as a stiffness
    return min(0.2 / period_s, 2 / max(time_constants))


def _by_name(mechanism: Mechanism, values: np.ndarray) -> float | Mapping[str, float]:
    """Return the values (n_s,) of the independent joints with two digits: one number for one joint, else by name."""
    found = {joint.name: float(f"{x:.2g}") for joint, x in zip(mechanism.independent_joints, values, strict=True)}
    return next(iter(found.values())) if len(found) == 1 else found
