"""A logged run shown in MuJoCo's interactive viewer, at the pace it was run or slower."""

import os
import sys
import time

import numpy as np

from linkplan.controllers.rollout import Rollout
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism

_FRAMES_PER_S = 60.0


def has_screen() -> bool:
    """Return whether a window can be opened: always tried on macOS and Windows, with a display set elsewhere."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def play(mechanism: Mechanism, rollout: Rollout, slowness: float, seconds: float | None = None) -> None:
    """Show a run again and again until its window is closed (or for some seconds), `slowness` times slower than real.

    Raises:
        LinkplanError: where no window can be opened.
    """
    if not has_screen():
        raise LinkplanError("view needs a screen, and none is there: neither DISPLAY nor WAYLAND_DISPLAY is set")
    import mujoco.viewer

    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(rollout.pose[0])
    mujoco.mj_forward(mechanism.model, data)
    try:
        window = mujoco.viewer.launch_passive(mechanism.model, data)
    except Exception as error:  # the window system's own errors have no common type
        raise LinkplanError(f"view cannot open a window: {error}") from error
    begin = time.monotonic()
    span = float(rollout.time_s[-1])
    with window:
        while window.is_running() and (seconds is None or time.monotonic() - begin < seconds):
            at = ((time.monotonic() - begin) / slowness) % (span + 0.5)
            k = min(int(np.searchsorted(rollout.time_s, at)), len(rollout.time_s) - 1)
            data.qpos[:] = mechanism.qpos_of(rollout.pose[k])
            data.time = float(rollout.time_s[k])
            mujoco.mj_forward(mechanism.model, data)
            window.sync()
            time.sleep(1.0 / _FRAMES_PER_S)
