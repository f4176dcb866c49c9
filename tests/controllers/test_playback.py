"""The viewer: keys change speed, tracker and gains; a run is shown in real time until its window is closed."""

import contextlib
import itertools
import queue
import sys
from types import ModuleType

import mujoco
import numpy as np
import pytest

from linkplan.controllers import playback
from linkplan.controllers.controls import HOLD_S, KEYS, Controls, advanced, pressed
from linkplan.controllers.playback import Shown, after_keys, pace, play
from linkplan.models.mechanism import load_mechanism
from tests.support.bodies import HINGE


class Window:
    """A window that is closed after some frames."""

    def __init__(self, frames: float) -> None:
        self.left, self.user_scn = frames, mujoco.MjvScene()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def is_running(self) -> bool:
        self.left -= 1
        return self.left >= 0

    def lock(self):
        return contextlib.nullcontext()

    def set_texts(self, _) -> None:
        pass

    def sync(self) -> None:
        pass


def played(monkeypatch, *, seconds: float | None = None, frames: float = np.inf, slowness: float = 1.0) -> list[int]:
    """Return the instants of four, an eighth of a second apart, that a window shows."""
    shown, now = [], [100.0]
    viewer = ModuleType("viewer")
    viewer.launch_passive = lambda *_, **__: Window(frames)
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewer)
    monkeypatch.setattr(mujoco, "viewer", viewer, raising=False)
    monkeypatch.setattr(playback, "has_screen", lambda: True)

    def sleep(_: float) -> None:
        now[0] += 0.125

    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr("time.sleep", sleep)
    run = Shown(
        time_s=0.125 * np.arange(4), pose=np.zeros((4, 1)), decorate=lambda _scene, k, _ghost: shown.append(k),
        words=lambda _: [("", "")],
    )  # fmt: skip
    controls = Controls(tracker="pd", slowness=slowness)
    assert play(load_mechanism(HINGE), controls, lambda _: run, seconds=seconds) == controls
    return shown


def test_a_run_is_shown_in_real_time_holds_its_end_for_half_a_second_and_begins_again(monkeypatch):
    assert played(monkeypatch, seconds=1.1) == [0, 1, 2, 3, 3, 3, 3, 0, 1]


def test_a_slower_run_shows_each_instant_for_longer(monkeypatch):
    assert played(monkeypatch, seconds=0.9, slowness=2.0) == [0, 1, 1, 2, 2, 3, 3, 3]


@pytest.mark.parametrize("seconds", [None, 10.0])
def test_a_run_is_shown_until_its_window_is_closed(monkeypatch, seconds):
    assert played(monkeypatch, seconds=seconds, frames=3) == [0, 1, 2]


START = Controls(tracker="pd", slowness=4.0)
KEY = {name: number for number, (name, _, _) in KEYS.items()}


def after(*names: str, start: Controls = START) -> Controls:
    for name in names:
        start = pressed(start, KEY[name])
    return start


@pytest.mark.parametrize(("less", "more", "gain"), [("6", "7", "kp_factor"), ("8", "9", "kd_factor")])
def test_a_gain_grows_and_shrinks_by_the_same_step_and_the_other_stays(less, more, gain):
    assert getattr(after(more), gain) == pytest.approx(1.25)
    assert getattr(after(less), gain) == pytest.approx(0.8)
    assert after(more, more, less, less) == START
    other = {"kp_factor": "kd_factor", "kd_factor": "kp_factor"}[gain]
    assert getattr(after(more, more), other) == 1.0


def test_only_trackers_and_gains_ask_for_another_run():
    assert all(after(name).run == START.run for name in ("Up", "Down", "Space", "End"))
    assert all(after(name).run != START.run for name in ("6", "7", "8", "9", "."))


def test_home_begins_again_with_the_first_gains():
    again = after("7", "9", "Space", "Home")
    assert again.run == START.run
    assert not again.paused
    assert again.begun == START.begun + 1


def test_every_key_has_the_code_of_the_window_s_library():
    glfw = pytest.importorskip("glfw", reason="glfw is not installed")
    assert {name: getattr(glfw, f"KEY_{name.replace('.', 'period')}".upper()) for name in KEY} == KEY


def test_keys_that_wait_are_all_heard_in_their_order():
    keys: queue.SimpleQueue[int] = queue.SimpleQueue()
    for name in ("7", "7", ".", "Space"):
        keys.put(KEY[name])
    assert after_keys(START, keys) == after("7", "7", ".", "Space")
    assert keys.empty()


def test_a_motion_goes_on_for_ever_and_holds_its_end():
    duration, at, shown = 1.0, 0.0, []
    for _ in range(200):
        at = advanced(at, 0.1, START, duration)
        shown.append(at)
    assert max(shown) > duration  # the end is held
    assert max(shown) < duration + HOLD_S / START.slowness
    assert sum(b < a for a, b in itertools.pairwise(shown)) == int(200 * 0.025 / (duration + 0.125))


def test_a_motion_that_is_stopped_stands_still():
    assert advanced(0.3, 10.0, after("Space"), 1.0) == 0.3


def test_what_is_written_says_speed_stop_and_refusal():
    assert pace(START, "") == [("speed", "4x slower")]
    said = pace(after("Space", *["Up"] * 3), "no gain")
    assert ("speed", "2x faster") in said
    assert ("refused", "no gain") in said
    assert len(said) == 3
