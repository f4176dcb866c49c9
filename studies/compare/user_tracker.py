"""A user's own tracker beside the built-in ones: what it may be, and a check of what it gives at every instant."""

import functools
import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.tracker import AnyTracker, Tracker, TrackerWithMemory
from linkplan.models.errors import LinkplanError, ProblemError, one_line
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import choose
from linkplan.studies.compare.tracker_source import ENTRY_POINTS, look_here, module_of, source_files

# A built-in name, a law, or what makes a law of the reference that it is to follow.
Asked = str | AnyTracker | Callable[[SampledReference], AnyTracker]

# What the modules of trackers held when they were loaded: in a process that lives on their files may change.
_loaded_from: dict[str, bytes] = {}


def tracker_named(text: str) -> Asked:
    """Return a built-in tracker's name, an installed package's tracker of that name, or what "module:object" names.

    Modules are looked for in the working folder too.

    Raises:
        ProblemError: when there is none.
    """
    text = known_tracker(text)
    if text in TRACKERS:
        return text
    if ":" in text:
        return _loaded(text, lambda: _object_of(*text.split(":", 1)))
    return _loaded(text, entry_points(group=ENTRY_POINTS)[text].load)


def known_tracker(text: str) -> str:
    """Return the name of a tracker, refused where it is none; a "module:object" is not loaded yet.

    Raises:
        ProblemError: for an unknown name.
    """
    text = text.strip()
    if text in TRACKERS or (":" in text and all(text.split(":", 1))):
        return text
    return choose("tracker", text, (*TRACKERS, *sorted(entry_points(group=ENTRY_POINTS).names)), ProblemError)


def _loaded(text: str, load: Callable[[], Any]) -> Asked:
    try:
        _forget_older(text)
        return load()
    except (Exception, SystemExit) as error:  # whatever a module of somebody else's does when it is loaded
        raise ProblemError(f"tracker '{text}' cannot be loaded: {type(error).__name__}: {one_line(error)}") from error


def _forget_older(text: str) -> None:
    """Let a tracker's modules be loaded anew where one of their files has changed since."""
    try:
        content = {name: path.read_bytes() for name, path in source_files(module_of(text)).items()}
    except (ProblemError, OSError):
        return  # loading it will say why
    if any(name in sys.modules and _loaded_from.get(name, held) != held for name, held in content.items()):
        for name in content:
            sys.modules.pop(name, None)
    _loaded_from.update(content)


def _object_of(module: str, name: str) -> Any:
    look_here()
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
    """A user's law whose efforts are checked: one number for each actuator, for each state where it is `batched`."""

    law: Tracker
    name: str
    actuators: tuple[str, ...]
    batched: bool = False

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N].

        Raises:
            ProblemError: when the law gives anything but one number for each actuator.
        """
        return _checked(self.law.effort(k, position, velocity), self.name, position.shape[:-1], self.actuators)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CheckedMemory:
    """A user's law with a memory, its efforts checked."""

    law: TrackerWithMemory
    name: str
    actuators: tuple[str, ...]

    def start(self, n: int) -> np.ndarray:
        """Return the memory (n, n_m) before the first control instant of n simulations."""
        memory = np.asarray(self.law.start(n))
        if memory.ndim != 2 or len(memory) != n:
            raise ProblemError(f"tracker '{self.name}' starts with a memory of shape ({n}, any), got {memory.shape}")
        return memory

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] and the next memory (n, n_m).

        Raises:
            ProblemError: when the law gives anything but one number for each actuator.
        """
        given, after = self.law.step(k, position, velocity, memory)
        return _checked(given, self.name, position.shape[:-1], self.actuators), np.asarray(after)


def _checked(given: object, name: str, states: tuple[int, ...], actuators: tuple[str, ...]) -> np.ndarray:
    try:
        effort = np.array(given, dtype=float)
    except (TypeError, ValueError):
        effort = np.zeros((0, 0))
    wanted = (*states, len(actuators))
    if effort.shape != wanted:
        got = repr(given) if effort.ndim == 2 and not effort.size else f"shape {effort.shape}"
        raise ProblemError(
            f"tracker '{name}' gives an array of one effort for each actuator ({', '.join(actuators)}),"
            f" shape {wanted}, got {got}"
        )
    return effort


def _is_law(thing: object) -> bool:
    """Return whether a thing is a law: it has effort, or start and step."""
    return any(all(callable(getattr(thing, name, None)) for name in names) for names in (("effort",), ("start", "step")))


def knows_batches(law: AnyTracker) -> bool:
    """Return whether a law is asked for many states at once."""
    return isinstance(law, CheckedMemory) or bool(getattr(law, "batched", False))


def users_tracker(asked: object, mechanism: Mechanism, reference: SampledReference) -> CheckedTracker | CheckedMemory:
    """Return a user's tracker for a reference: the law itself, or what a function (or class) makes of the reference.

    Raises:
        ProblemError: when it is no tracker: a name and `effort(k, position, velocity)`, or `start` and `step`.
    """
    law: Any = asked
    if isinstance(asked, type) or not _is_law(asked):
        if not callable(asked):
            raise ProblemError(
                f"a tracker is one of {', '.join(TRACKERS)}, an object with a name and effort(k, position, velocity), or a"
                f" function of the sampled reference that returns one; got {asked!r}"
            )
        try:
            law = asked(reference)
        except LinkplanError:
            raise
        except Exception as error:  # the user's own code, whatever it raises
            made_by = getattr(asked, "__name__", asked)
            raise ProblemError(f"tracker '{made_by}' cannot be made: {type(error).__name__}: {one_line(error)}") from error
        if not _is_law(law):
            raise ProblemError(
                "a function that is given as a tracker returns an object with a name and effort(k, position, velocity),"
                f" got {law!r}"
            )
    name = getattr(law, "name", None)
    if not isinstance(name, str) or not name.strip():
        raise ProblemError(f"a tracker's name is a word for tables and figures, got {name!r}")
    actuators = tuple(actuator.name for actuator in mechanism.actuators)
    if not callable(getattr(law, "effort", None)):
        return CheckedMemory(law=law, name=name, actuators=actuators)
    return CheckedTracker(law=law, name=name, actuators=actuators, batched=bool(getattr(law, "batched", False)))
