"""A user's own tracker beside the built-in ones: what it may be, and a check of what it gives at every instant."""

import functools
import importlib
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.tracker import Tracker
from linkplan.models.errors import ProblemError, one_line
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import choose

# A built-in name, a law, or what makes a law of the reference that it is to follow.
Asked = str | Tracker | Callable[[SampledReference], Tracker]


# Where installed packages say what trackers they have.
ENTRY_POINTS = "linkplan.trackers"


def tracker_named(text: str) -> Asked:
    """Return a built-in tracker's name, an installed package's tracker of that name, or what "module:object" names.

    Modules are looked for in the working folder too.

    Raises:
        ProblemError: when there is none.
    """
    text = text.strip()
    if text in TRACKERS:
        return text
    if ":" not in text:
        from importlib.metadata import entry_points

        installed = entry_points(group=ENTRY_POINTS)
        if text not in installed.names:
            return choose("tracker", text, (*TRACKERS, *sorted(installed.names)), ProblemError)
        return _loaded(text, installed[text].load)
    return _loaded(text, lambda: _object_of(*text.split(":", 1)))


def _loaded(text: str, load: Callable[[], Any]) -> Asked:
    try:
        return load()
    except Exception as error:  # whatever a module of somebody else's does when it is loaded
        raise ProblemError(f"tracker '{text}' cannot be loaded: {type(error).__name__}: {one_line(error)}") from error


def _object_of(module: str, name: str) -> Any:
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    return functools.reduce(getattr, name.split("."), importlib.import_module(module))


def trackers_named(text: str) -> list[Asked]:
    """Return the trackers of a list "pd+ff, mpc, laws:Mine"; "all" are the built-in ones."""
    if text.strip() == "all":
        return list(TRACKERS)
    names = [name for name in text.split(",") if name.strip()]
    if not names:
        raise ProblemError(f"trackers are names with commas between them, or all; got '{text}'")
    return [tracker_named(name) for name in names]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CheckedTracker:
    """A user's law whose efforts are checked: one finite-shaped number for each actuator."""

    law: Tracker
    name: str
    actuators: tuple[str, ...]

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return efforts (n_u,) [N.m or N].

        Raises:
            ProblemError: when the law gives anything but one number for each actuator.
        """
        given = self.law.effort(k, position, velocity)
        try:
            effort = np.array(given, dtype=float)
        except (TypeError, ValueError):
            effort = np.zeros((0, 0))
        if effort.shape != (len(self.actuators),):
            got = repr(given) if effort.ndim == 2 and not effort.size else f"shape {effort.shape}"
            raise ProblemError(
                f"tracker '{self.name}' gives an array of one effort for each actuator ({', '.join(self.actuators)}),"
                f" shape ({len(self.actuators)},), got {got}"
            )
        return effort


def users_tracker(asked: object, mechanism: Mechanism, reference: SampledReference) -> CheckedTracker:
    """Return a user's tracker for a reference: the law itself, or what a function (or class) makes of the reference.

    Raises:
        ProblemError: when it is no tracker: a name and `effort(k, position, velocity)`.
    """
    law = asked
    if isinstance(asked, type) or not callable(getattr(asked, "effort", None)):
        if not callable(asked):
            raise ProblemError(
                f"a tracker is one of {', '.join(TRACKERS)}, an object with a name and effort(k, position, velocity), or a"
                f" function of the sampled reference that returns one; got {asked!r}"
            )
        law = asked(reference)
        if not callable(getattr(law, "effort", None)):
            raise ProblemError(
                "a function that is given as a tracker returns an object with a name and effort(k, position, velocity),"
                f" got {law!r}"
            )
    name = getattr(law, "name", None)
    if not isinstance(name, str) or not name.strip():
        raise ProblemError(f"a tracker's name is a word for tables and figures, got {name!r}")
    return CheckedTracker(law=law, name=name, actuators=tuple(actuator.name for actuator in mechanism.actuators))
