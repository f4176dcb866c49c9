"""Stability trials in MuJoCo: disturbed loops run side by side until the disturbance has decayed or grown."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.tree.joints import unit_steps
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop
from linkplan.studies.feedback.frequency.simulated_loops import simulated

# Initial velocity [rad/s or m/s], far above the simulator's rounding of 1e-11.
_KICK_VELOCITY = 1e-3
# Share of the distance to the effort limits that the kick's command may use, so that growth is visible before saturation.
_KICK_EFFORT_SHARE = 1e-3
# A loop is decided when its speed has grown or decayed by this factor. At the end of the time the trend decides.
_DECISIVE_FACTOR = 300.0
# A speed of this many kicks is growth; the command is then still well inside the limits.
_GROWTH_FACTOR = 100.0
# A loop at rest this far [rad; on a slide, share of the extent] from its pose has fallen; soft loops sink by a third of it.
_FALL_DISTANCE = 0.1
MAX_TRIAL_PERIODS = 40_000


def settle_trials(
    loops: Sequence[FeedbackLoop], effort_limit: np.ndarray, most_periods: int = MAX_TRIAL_PERIODS
) -> np.ndarray:
    """Return a mask (n,) of the loops, all of one timing, that settle in MuJoCo after a small kick to their joints."""
    mechanism, n = loops[0].point.mechanism, len(loops)
    n_s = mechanism.dof
    state = np.array([loop.point.state for loop in loops])
    hold = np.array([loop.point.hold for loop in loops])
    room = np.abs(effort_limit[None] - hold[:, :, None]).min(axis=2)
    pushes = np.abs(np.array([loop.gain for loop in loops])[:, :, n_s:]).sum(axis=2)
    with np.errstate(divide="ignore"):
        kick = np.minimum(_KICK_VELOCITY, (_KICK_EFFORT_SHARE * room / pushes).min(axis=1))
    batch = simulated(loops, effort_limit, kick[:, None] * mechanism.actuated)
    settles = np.zeros(n, dtype=bool)
    unit = unit_steps(mechanism.joints, mechanism.extent_m)[mechanism.independent][mechanism.actuated]
    active, history = np.arange(n), []
    while active.size:
        reference, push = (np.repeat(value[None, active], 100, axis=0) for value in (state, hold))
        x, _ = batch.run(active, reference, push)
        speed = np.full(n, np.inf)
        with np.errstate(invalid="ignore"):
            now = np.abs(x[:, :, n_s:][:, :, mechanism.actuated]).max(axis=(0, 2))
        speed[active] = np.where(np.isfinite(now), now, np.inf)
        history.append(speed)
        log_speed = np.log(np.maximum(np.array(history)[:, active], 1e-300))
        half = len(history) // 2
        with np.errstate(invalid="ignore"):  # infinity minus infinity after divergence
            late_change, change = log_speed[-1] - log_speed[half], log_speed[-1] - log_speed[0]
        decisive = (np.abs(change) > np.log(_DECISIVE_FACTOR)) | ~np.isfinite(change)
        # A loop may decay or grow within the first check interval: compare with the kick itself.
        decayed = speed[active] < kick[active] / _DECISIVE_FACTOR
        # Soft loops initially sink under the weight, faster than the kick. A speed that does not fall again has grown.
        falls = np.min(history[-5:], axis=0) < np.min(history[:-5], axis=0, initial=np.inf)
        grown = ~(speed[active] < _GROWTH_FACTOR * kick[active]) & ~falls[active]
        finished = decisive | decayed | grown | (batch.periods >= most_periods)
        trend = np.where(decisive, change, late_change)
        off = np.abs(x[-1, :, :n_s] - state[active, :n_s])[:, mechanism.actuated] / unit
        near = off.max(axis=1) < _FALL_DISTANCE
        settles[active[finished]] = (near & (decayed | (~grown & (trend < 0))))[finished]
        active = active[~finished]
    return settles
