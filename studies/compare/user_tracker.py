"""Trackers written by users: how they are specified and loaded, and a check of their efforts at every instant."""

import contextlib
import functools
import importlib
import pickle
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.tracker import AnyTracker, Tracker, TrackerWithMemory
from linkplan.models.errors import ProblemError, choose, one_line, shortened
from linkplan.models.mechanism import Mechanism
from linkplan.studies.compare.tracker_source import ENTRY_POINTS, add_cwd_to_path, module_of, source_files

# A built-in name, a law, or a function from the reference to a law.
TrackerLike = str | AnyTracker | Callable[[SampledReference], AnyTracker]

# Number of characters of a user's object or error that a message quotes.
_QUOTED_CHARACTERS = 300
# Longest name of a tracker: it is part of file names, which have at most 255 bytes.
_LONGEST_NAME = 50
# The method that a tracker for one state defines, for messages.
_LAW = "effort(k, position_rad, velocity_rad_s)"
# Contents of the trackers' modules at import, because the files may change during a long process.
_loaded_from: dict[str, bytes] = {}


def tracker_named(text: str) -> TrackerLike:
    """Return a built-in tracker's name, an installed package's tracker of that name, or the object of "module:object".

    The module search path includes the working folder.

    Raises:
        ProblemError: for an unknown tracker.
    """
    text = known_tracker(text)
    if text in TRACKERS:
        return text
    if ":" in text:
        return _loaded(text, lambda: _object_of(*text.split(":", 1)))
    return _loaded(text, entry_points(group=ENTRY_POINTS)[text].load)


def known_tracker(text: str) -> str:
    """Return the checked name of a tracker; a "module:object" is not loaded yet.

    Raises:
        ProblemError: for an unknown name.
    """
    text = text.strip()
    if text in TRACKERS or (":" in text and all(text.split(":", 1))):
        return text
    return choose("tracker", text, (*TRACKERS, *sorted(entry_points(group=ENTRY_POINTS).names)), ProblemError)


@contextlib.contextmanager
def users_code(name: str, doing: str) -> Iterator[None]:
    """Turn every exception of a user's code into an error that names the tracker.

    SystemExit is included, because it would end the command with the tracker's exit code and lose the result.

    Raises:
        ProblemError: "tracker 'name' fails here: KindOfError: its text"
    """
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        what = ": ".join(part for part in (type(error).__name__, _text_of(error)) if part)
        raise ProblemError(f"tracker '{name}' {doing}: {what}") from error


def _text_of(thing: object) -> str:
    """Return the beginning of a user's object as one line, or its type if its conversion to text fails."""
    try:
        text = one_line(thing)
    except KeyboardInterrupt:
        raise
    except BaseException:
        text = f"<{type(thing).__name__}>"
    return shortened(text, _QUOTED_CHARACTERS)


def _loaded(text: str, load: Callable[[], Any]) -> TrackerLike:
    with users_code(text, "cannot be loaded"):
        content: dict[str, bytes] = {}
        with contextlib.suppress(ProblemError, OSError):  # the import reports the error
            content = {name: path.read_bytes() for name, path in source_files(module_of(text)).items()}
        if any(name in sys.modules and _loaded_from.get(name, held) != held for name, held in content.items()):
            for name in content:  # one of the tracker's files has changed since the import
                sys.modules.pop(name, None)
        _loaded_from.update(content)
        return load()


def _object_of(module: str, name: str) -> Any:
    add_cwd_to_path()
    return functools.reduce(getattr, name.split("."), importlib.import_module(module))


def name_of(given: object) -> str:
    """Return the name that an experiment gives to an object, a class or a function: "own:" and its own name.

    Raises:
        ProblemError: if it is none of these, or its name has invalid characters.
    """
    if not (isinstance(given, type) or callable(given) or _is_law(given)):
        raise ProblemError(
            f"a tracker must be one of {', '.join(TRACKERS)}, an object, a class or a function; got {_text_of(given)}"
        )
    names = [getattr(given, key, None) for key in ("name", "__name__")]
    name = next((one for one in names if isinstance(one, str) and one.strip()), type(given).__name__)
    if not name.isprintable() or len(name) > _LONGEST_NAME:
        raise ProblemError(
            f"a tracker's name must have at most {_LONGEST_NAME} printable characters, got {_text_of(name)!r}"
        )
    return f"own:{name}"


def refuse_unpicklable(given: Mapping[str, TrackerLike]) -> None:
    """Refuse trackers, by name, that cannot be sent to other processes.

    Raises:
        ProblemError: with the name of the first one that cannot be pickled.
    """
    for name, one in given.items():
        try:
            pickle.dumps(one)
        except Exception as error:
            raise ProblemError(
                f"tracker '{name}' cannot be sent to other processes; use workers=1 or define it in a module:"
                f" {_text_of(error)}"
            ) from error


def trackers_loaded(asked: Sequence[TrackerLike]) -> list[TrackerLike]:
    """Return trackers; those given by name are loaded.

    Raises:
        ProblemError: for an unknown tracker.
    """
    return [tracker_named(one) if isinstance(one, str) else one for one in asked]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CheckedTracker:
    """A user's law with a check that it returns one number for each actuator (and each state, if `batched`)."""

    law: Tracker
    name: str
    actuators: tuple[str, ...]
    batched: bool = False

    def effort(self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N].

        Raises:
            ProblemError: if the law raises, or does not return one number for each actuator.
        """
        with users_code(self.name, f"fails at control instant {k}"):
            given = self.law.effort(k, position_rad, velocity_rad_s)
        return _checked(given, self.name, position_rad.shape[:-1], self.actuators)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CheckedMemory:
    """A user's law with a memory, with a check of its efforts."""

    law: TrackerWithMemory
    name: str
    actuators: tuple[str, ...]

    def start(self, n: int) -> np.ndarray:
        """Return the memory (n, n_m) before the first control instant of n simulations."""
        with users_code(self.name, "cannot start"):
            memory = np.asarray(self.law.start(n))
        if memory.ndim != 2 or len(memory) != n:
            raise ProblemError(f"tracker '{self.name}' must start with a memory of shape ({n}, any), got {memory.shape}")
        return memory

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] and the next memory (n, n_m).

        Raises:
            ProblemError: if the law raises, does not return one number for each actuator, or changes the memory's shape.
        """
        with users_code(self.name, f"fails at control instant {k}"):
            given, after = self.law.step(k, position_rad, velocity_rad_s, memory)
            after = np.asarray(after)
        if after.shape != memory.shape:
            raise ProblemError(f"tracker '{self.name}' must return a memory of shape {memory.shape}, got {after.shape}")
        return _checked(given, self.name, position_rad.shape[:-1], self.actuators), after


def _checked(given: object, name: str, states: tuple[int, ...], actuators: tuple[str, ...]) -> np.ndarray:
    effort = None
    with contextlib.suppress(ProblemError), users_code(name, "gives no numbers"), warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy only warns when it drops an imaginary part
        effort = np.array(given, dtype=float)
    wanted = (*states, len(actuators))
    if effort is None or effort.shape != wanted:
        got = _text_of(given) if effort is None else f"shape {effort.shape}"
        raise ProblemError(
            f"tracker '{name}' must return one effort for each actuator ({', '.join(actuators)}), shape {wanted}, got {got}"
        )
    return effort


def _is_law(thing: object) -> bool:
    """Return True for an object with `effort`, or with `start` and `step`. Attribute access may run the user's code."""
    with users_code(type(thing).__name__, "cannot be used"):
        return _has(thing, "effort") or _has(thing, "start", "step")


def _has(thing: object, *methods: str) -> bool:
    return all(callable(getattr(thing, name, None)) for name in methods)


def knows_batches(law: AnyTracker) -> bool:
    """Return True if a law accepts many states at once."""
    return isinstance(law, CheckedMemory) or bool(getattr(law, "batched", False))


def users_tracker(asked: object, mechanism: Mechanism, reference: SampledReference) -> CheckedTracker | CheckedMemory:
    """Return a user's tracker for a reference: the law itself, or the result of a function or class of the reference.

    Raises:
        ProblemError: if it does not have a name and `effort(k, position_rad, velocity_rad_s)`, or `start` and `step`.
    """
    law: Any = asked
    made_by = _text_of(getattr(asked, "__name__", type(asked).__name__))
    if isinstance(asked, type) or not _is_law(asked):
        if not callable(asked):
            raise ProblemError(
                f"a tracker must be one of {', '.join(TRACKERS)}, an object with a name and {_LAW}, or a function of the"
                f" sampled reference that returns one; got {_text_of(asked)}"
            )
        with users_code(made_by, "cannot be made"):
            law = asked(reference)
        if not _is_law(law):
            raise ProblemError(
                f"a function given as a tracker must return an object with a name and {_LAW}; '{made_by}' returned"
                f" {_text_of(law)}"
            )
    with users_code(made_by, "cannot be used"):
        name, batched, remembers = getattr(law, "name", None), bool(getattr(law, "batched", False)), not _has(law, "effort")
    if not isinstance(name, str) or not name.strip() or not name.isprintable() or len(name) > _LONGEST_NAME:
        raise ProblemError(
            f"a tracker's name must have at most {_LONGEST_NAME} printable characters, for tables, figures and files; that"
            f" of '{made_by}' is {_text_of(name)!r}"
        )
    actuators = tuple(actuator.name for actuator in mechanism.actuators)
    if remembers:
        return CheckedMemory(law=law, name=name, actuators=actuators)
    return CheckedTracker(law=law, name=name, actuators=actuators, batched=batched)
