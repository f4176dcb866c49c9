"""Motions to be drawn that need no plan: a mechanism led through a wave, and the same a little astray."""

from functools import cache

import numpy as np

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.studies.render.efforts import load_shares
from linkplan.studies.render.motion import TrackedMotion
from linkplan.studies.render.scenes import Scene

# Control instants, their period [s], the wave's height [rad or m] and how far the run is astray in its second half.
N, PERIOD_S, WAVE, ASTRAY = 41, 0.005, 0.3, 0.1


@cache
def waved(source: str, wave: float = WAVE, astray: float = ASTRAY) -> TrackedMotion:
    """Return a motion of a mechanism's first coordinate: a wave from home, with an effort that grows to its limit.

    Over the first half it is tracked exactly, over the second it is astray.
    """
    mechanism = load_mechanism(source)
    time = PERIOD_S * np.arange(N)
    planned = follow(mechanism, _wave(mechanism, wave * np.sin(np.pi * np.arange(N) / (N - 1))), mechanism.home)
    off = astray * np.clip(np.arange(N) - N // 2, 0, None) / (N // 2)
    tracked = follow(mechanism, _wave(mechanism, wave * np.sin(np.pi * np.arange(N) / (N - 1)) - off), mechanism.home)
    limit = mechanism.effort_limit
    effort = np.outer(np.linspace(0.0, 1.0, N), limit[:, 1])
    return TrackedMotion(
        mechanism=mechanism,
        name=mechanism.name,
        tracker="pd",
        time_s=time,
        pose=tracked,
        reference=planned,
        effort=effort,
        limit=limit,
        shares=load_shares(effort, limit, effort.max(axis=0)),
        stable=True,
        repeats=False,
        passed=True,
    )


def _wave(mechanism: Mechanism, height: np.ndarray) -> np.ndarray:
    positions = np.tile(mechanism.home[mechanism.independent], (len(height), 1))
    positions[:, 0] += height
    return positions


def rods(scene: Scene, which: int) -> np.ndarray:
    """Return the ends (n, 2, 3) [m] of one figure's rods: 0 the ghost, -1 the mechanism."""
    return np.array([[shape.start, shape.end] for shape in scene.figures[which].shapes])
