"""A run in the viewer's window, which is a dummy whose clock advances by an eighth of a second with every frame."""

import contextlib
import sys
from types import ModuleType

import mujoco
import numpy as np
import pytest

from linkplan.controllers import playback
from linkplan.controllers.controls import Controls
from linkplan.controllers.playback import Shown, play
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
