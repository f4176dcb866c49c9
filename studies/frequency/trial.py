"""Does a feedback loop settle in MuJoCo? Disturbed loops, run side by side until the disturbance has decayed or grown."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.studies.frequency.feedback_loops import FeedbackLoop
from linkplan.studies.frequency.simulated_loops import SimulatedLoops

# The kick [rad/s or m/s], and the share of the room to the effort limits that its command may take: a growing loop is to be
# seen before its limits change it. The simulator's rounding shows in velocities of 1e-11.
_KICK, _ROOM = 1e-3, 1e-3
# The verdict is plain when speeds have grown or shrunk by this factor, and is the trend's at the end of the time.
_PLAIN = 300.0
# A speed this many times the kick's is growth, and still well below what the limits would make of it.
_GROWN = 100.0
_CHUNK = 100
MOST_PERIODS = 40_000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Trials:
    """Which loops settle (n,), and the control periods that were needed to see it."""

    settles: np.ndarray
    periods: int


def settle_trials(loops: Sequence[FeedbackLoop], effort_limit: np.ndarray, most_periods: int = MOST_PERIODS) -> Trials:
    """Return whether MuJoCo's own runs of loops of one timing settle after a small kick to every independent joint."""
    mechanism, timing, n = loops[0].point.mechanism, loops[0].timing, len(loops)
    n_s = mechanism.dof
    state = np.array([loop.point.state for loop in loops])
    hold = np.array([loop.point.hold for loop in loops])
    room = np.abs(effort_limit[None] - hold[:, :, None]).min(axis=2)
    pushes = np.abs(np.array([loop.gain for loop in loops])[:, :, n_s:]).sum(axis=2)
    with np.errstate(divide="ignore"):
        kick = np.minimum(_KICK, (_ROOM * room / pushes).min(axis=1))
    batch = SimulatedLoops(
        mechanism,
        pose=np.array([loop.point.pose for loop in loops]),
        velocity=np.repeat(kick[:, None], n_s, axis=1),
        gain=np.array([loop.gain for loop in loops]),
        under_way=hold,
        timing=timing,
        effort_limit=effort_limit,
    )
    settles = np.zeros(n, dtype=bool)
    active, history = np.arange(n), []
    while active.size:
        reference, push = (np.repeat(value[None, active], _CHUNK, axis=0) for value in (state, hold))
        x, _ = batch.run(active, reference, push)
        speed = np.full(n, np.inf)
        with np.errstate(invalid="ignore"):
            now = np.abs(x[:, :, n_s:]).max(axis=(0, 2))
        speed[active] = np.where(np.isfinite(now), now, np.inf)
        history.append(speed)
        shape = np.log(np.maximum(np.array(history)[:, active], 1e-300))
        half = len(history) // 2
        with np.errstate(invalid="ignore"):  # infinity less infinity, of what blew up
            rate, change = shape[-1] - shape[half], shape[-1] - shape[0]
        plain = np.abs(change) > np.log(_PLAIN)
        over = plain | ~np.isfinite(change) | (batch.periods >= most_periods)
        # Where all is over within the first stretch, the kick itself is the measure.
        gone = speed[active] < kick[active] / _PLAIN
        blown = ~(speed[active] < _GROWN * kick[active])
        over |= gone | blown
        trend = np.where(plain | ~np.isfinite(change), change, rate)
        done = active[over]
        settles[done] = np.where(gone, True, np.where(blown, False, trend < 0))[over]
        active = active[~over]
    return Trials(settles=settles, periods=batch.periods)
