"""The viewer's controls (tracker, gains, speed) and the keys that change them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from linkplan.controllers.trackers.names import TRACKERS

# One key press changes a gain by this factor.
_GAIN_STEP = 1.25
# The last pose is held this long before the motion restarts.
HOLD_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Controls:
    """A tracker, factors on the problem's gains, and the display: `slowness` times slower than real time."""

    tracker: str
    slowness: float
    kp_factor: float = 1.0
    kd_factor: float = 1.0
    paused: bool = False
    ghost: bool = True
    begun: int = 0  # number of restarts

    @property
    def run(self) -> tuple[str, float, float]:
        """The settings that require a new simulation when they change."""
        return self.tracker, self.kp_factor, self.kd_factor


def _gains(controls: Controls, kp_step: float, kd_step: float) -> Controls:
    def limited(factor: float) -> float:
        found = min(max(factor, 1e-3), 1e3)
        return 1.0 if abs(found - 1.0) < 1e-9 else found

    return replace(
        controls, kp_factor=limited(controls.kp_factor * kp_step), kd_factor=limited(controls.kd_factor * kd_step)
    )


def _slower(controls: Controls, step: float) -> Controls:
    return replace(controls, slowness=min(max(controls.slowness * step, 0.1), 1e5))


def _next_tracker(controls: Controls) -> Controls:
    return replace(controls, tracker=TRACKERS[(TRACKERS.index(controls.tracker) + 1) % len(TRACKERS)])


def _again(controls: Controls) -> Controls:
    return replace(controls, kp_factor=1.0, kd_factor=1.0, paused=False, begun=controls.begun + 1)


# GLFW's key code: name, effect, and function. MuJoCo's viewer does not use these keys itself.
KEYS: Mapping = {
    54: ("6", "kp less", lambda c: _gains(c, 1 / _GAIN_STEP, 1.0)),
    55: ("7", "kp more", lambda c: _gains(c, _GAIN_STEP, 1.0)),
    56: ("8", "kd less", lambda c: _gains(c, 1.0, 1 / _GAIN_STEP)),
    57: ("9", "kd more", lambda c: _gains(c, 1.0, _GAIN_STEP)),
    46: (".", "the next tracker", _next_tracker),
    264: ("Down", "slower", lambda c: _slower(c, 2.0)),
    265: ("Up", "faster", lambda c: _slower(c, 0.5)),
    32: ("Space", "stop, go on", lambda c: replace(c, paused=not c.paused)),
    269: ("End", "the plan's ghost", lambda c: replace(c, ghost=not c.ghost)),
    268: ("Home", "restart with the first gains", _again),
}
# Every key and its effect as one line.
KEYS_TEXT = "; ".join(f"{name} {does}" for name, does, _ in KEYS.values())


def pressed(controls: Controls, key: int) -> Controls:
    """Return the controls after a key press (GLFW's key code); other keys change nothing."""
    return KEYS[key][2](controls) if key in KEYS else controls


def advanced(at_s: float, elapsed_s: float, controls: Controls, duration_s: float) -> float:
    """Return the motion's time [s] after some real time. The motion is repeated, with a pause at its end.

    Args:
        at_s: the motion's previous time [s], beyond `duration_s` during the pause.
        elapsed_s: real time since then [s].
        controls: the present controls.
        duration_s: the motion's duration [s].
    """
    if controls.paused:
        return at_s
    return (at_s + elapsed_s / controls.slowness) % (duration_s + HOLD_S / controls.slowness)
