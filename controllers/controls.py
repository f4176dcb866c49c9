"""What can be changed while a run is watched: tracker, gains, speed; and the keys that change it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from linkplan.controllers.trackers.names import TRACKERS

# One press changes a gain by a quarter, and the speed by two; further than these factors nothing goes.
_GAIN_STEP, _MOST_GAIN = 1.25, 1000.0
_SPEED_STEP, _SLOWEST, _FASTEST = 2.0, 1e5, 0.1
# At the end of a motion its last pose is held so long [s], to be seen, before it begins again.
HOLD_S = 0.5

# GLFW's numbers of the keys that MuJoCo's viewer has no use for itself.
_SPACE, _PERIOD, _6, _7, _8, _9 = 32, 46, 54, 55, 56, 57
_DOWN, _UP, _HOME, _END = 264, 265, 268, 269


@dataclass(frozen=True, slots=True, kw_only=True)
class Controls:
    """A tracker, factors on the gains of its problem, and how the run is shown: `slowness` times slower than real."""

    tracker: str
    slowness: float
    kp_factor: float = 1.0
    kd_factor: float = 1.0
    paused: bool = False
    ghost: bool = True
    begun: int = 0  # how often it was begun again

    @property
    def run(self) -> tuple[str, float, float]:
        """What the run depends on: with another of these it is another run."""
        return self.tracker, self.kp_factor, self.kd_factor


def _gains(controls: Controls, kp_step: float, kd_step: float) -> Controls:
    def limited(factor: float) -> float:
        found = min(max(factor, 1.0 / _MOST_GAIN), _MOST_GAIN)
        return 1.0 if abs(found - 1.0) < 1e-9 else found

    return replace(
        controls, kp_factor=limited(controls.kp_factor * kp_step), kd_factor=limited(controls.kd_factor * kd_step)
    )


def _slower(controls: Controls, step: float) -> Controls:
    return replace(controls, slowness=min(max(controls.slowness * step, _FASTEST), _SLOWEST))


def _next_tracker(controls: Controls) -> Controls:
    return replace(controls, tracker=TRACKERS[(TRACKERS.index(controls.tracker) + 1) % len(TRACKERS)])


def _again(controls: Controls) -> Controls:
    return replace(controls, kp_factor=1.0, kd_factor=1.0, paused=False, begun=controls.begun + 1)


# A key's number: how it is called, what it does, and the function that does it.
KEYS: Mapping = {
    _6: ("6", "kp less", lambda c: _gains(c, 1 / _GAIN_STEP, 1.0)),
    _7: ("7", "kp more", lambda c: _gains(c, _GAIN_STEP, 1.0)),
    _8: ("8", "kd less", lambda c: _gains(c, 1.0, 1 / _GAIN_STEP)),
    _9: ("9", "kd more", lambda c: _gains(c, 1.0, _GAIN_STEP)),
    _PERIOD: (".", "the next tracker", _next_tracker),
    _DOWN: ("Down", "slower", lambda c: _slower(c, _SPEED_STEP)),
    _UP: ("Up", "faster", lambda c: _slower(c, 1 / _SPEED_STEP)),
    _SPACE: ("Space", "stop, go on", lambda c: replace(c, paused=not c.paused)),
    _END: ("End", "the plan's ghost", lambda c: replace(c, ghost=not c.ghost)),
    _HOME: ("Home", "begin again, first gains", _again),
}


def pressed(controls: Controls, key: int) -> Controls:
    """Return the controls after a key, by GLFW's number of it; the same where the key is none of ours."""
    return KEYS[key][2](controls) if key in KEYS else controls


def advanced(at_s: float, elapsed_s: float, controls: Controls, duration_s: float) -> float:
    """Return the motion's time [s] after some time on the wall: it goes on for ever, its end held for a moment.

    Args:
        at_s: the motion's time before, beyond `duration_s` while the end is held.
        elapsed_s: on the wall.
        controls: that hold meanwhile.
        duration_s: of the motion.
    """
    if controls.paused:
        return at_s
    return (at_s + elapsed_s / controls.slowness) % (duration_s + HOLD_S / controls.slowness)


def keys_said() -> str:
    """Return every key and what it does, in one line."""
    return "; ".join(f"{name} {does}" for name, does, _ in KEYS.values())
