"""A tracked motion, repeated in MuJoCo's interactive viewer; keys change gains, tracker and speed during playback."""

import os
import queue
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.controls import KEYS, Controls, advanced, pressed
from linkplan.models.deadline import check
from linkplan.models.errors import LinkplanError, one_line
from linkplan.models.mechanism import Mechanism

# Rows of two columns of text.
Rows = Sequence[tuple[str, str]]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Shown:
    """A run to be shown: its instants (n,) [s] and poses (n, n_q), additional drawings and text.

    `decorate(scene, k, ghost)` adds the drawings of instant k to MuJoCo's scene; `words(k)` returns rows of text.
    """

    time_s: np.ndarray
    pose: np.ndarray
    decorate: Callable[[object, int, bool], None]
    words: Callable[[int], Rows]
    stable: bool = True


def has_screen() -> bool:
    """Return True on macOS and Windows, and elsewhere if a display is set."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def play(
    mechanism: Mechanism,
    controls: Controls,
    make: Callable[[Controls], Shown],
    *,
    seconds: float | None = None,
    camera: Callable[[object], None] | None = None,
) -> Controls:
    """Repeat a run until its window is closed or the time is over, and return the last controls.

    Args:
        mechanism: the mechanism to show.
        controls: the initial controls.
        make: returns the run of a tracker and gains; called again after a key changed them. Its errors are shown.
        seconds: time [s] after which the window closes; default: never.
        camera: called with MuJoCo's camera before the first frame.

    Raises:
        LinkplanError: if no window can be opened, or if `make` refuses the first run.
    """
    if not has_screen():
        raise LinkplanError("view needs a screen: neither DISPLAY nor WAYLAND_DISPLAY is set")
    import mujoco.viewer

    shown = make(controls)
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(shown.pose[0])
    mujoco.mj_forward(mechanism.model, data)
    keys: queue.SimpleQueue[int] = queue.SimpleQueue()
    try:
        window = mujoco.viewer.launch_passive(
            mechanism.model, data, key_callback=keys.put, show_left_ui=False, show_right_ui=False
        )
    except Exception as error:  # the window system's own errors have no common type
        raise LinkplanError(f"view cannot open a window: {error}") from error
    begin = last = time.monotonic()
    at, refused = 0.0, ""
    with window:
        if camera is not None:
            with window.lock():
                camera(window.cam)
        while window.is_running() and (seconds is None or time.monotonic() - begin < seconds):
            check()
            asked = after_keys(controls, keys)
            if asked.run != controls.run:
                window.set_texts(_texts(mujoco, [("tracker", asked.tracker), ("", "is being run ...")]))
                window.sync()
                try:
                    shown, refused = make(asked), ""
                except LinkplanError as error:  # the previous run is shown again
                    refused = one_line(error)[:100]
                at, last = 0.0, time.monotonic()
            at = 0.0 if asked.begun != controls.begun else at
            controls = asked
            now = time.monotonic()
            at, last = advanced(at, now - last, controls, float(shown.time_s[-1])), now
            k = min(int(np.searchsorted(shown.time_s, at)), len(shown.time_s) - 1)
            with window.lock():
                data.qpos[:] = mechanism.qpos_of(shown.pose[k])
                data.time = float(shown.time_s[k])
                mujoco.mj_forward(mechanism.model, data)
                window.user_scn.ngeom = 0
                shown.decorate(window.user_scn, k, controls.ghost)
            window.set_texts(_texts(mujoco, (*shown.words(k), *pace(controls, refused))))
            window.sync()
            time.sleep(1.0 / 60.0)
    return controls


def after_keys(controls: Controls, keys: "queue.SimpleQueue[int]") -> Controls:
    """Return the controls after all key presses in a queue."""
    while True:
        try:
            controls = pressed(controls, keys.get_nowait())
        except queue.Empty:
            return controls


def pace(controls: Controls, refused: str) -> Rows:
    """Return the rows of text on the playback speed, and on the reason if a run was refused."""
    slow = controls.slowness
    rows = [("speed", f"{slow:g}x slower" if slow >= 1 else f"{1 / slow:g}x faster")]
    if controls.paused:
        rows.append(("", "stopped"))
    return [*rows, ("refused", refused)] if refused else rows


def _texts(mujoco, rows: Rows) -> list[tuple]:
    """Return the overlay texts of MuJoCo's viewer: rows at the upper left, keys at the lower right."""
    labels, values = ("\n".join(column) for column in zip(*rows, strict=True))
    keys, does = ("\n".join(column) for column in zip(*[row[:2] for row in KEYS.values()], strict=True))
    return [
        (mujoco.mjtFontScale.mjFONTSCALE_150, mujoco.mjtGridPos.mjGRID_TOPLEFT, labels, values),
        (mujoco.mjtFontScale.mjFONTSCALE_100, mujoco.mjtGridPos.mjGRID_BOTTOMRIGHT, keys, does),
    ]
