"""A user's own tracker beside the built-in ones: what it may be, and a check of what it gives at every instant."""

import contextlib
import functools
import importlib
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.tracker import AnyTracker, Tracker, TrackerWithMemory
from linkplan.models.errors import ProblemError, one_line
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import choose
from linkplan.studies.compare.tracker_source import ENTRY_POINTS, look_here, module_of, source_files

# A built-in name, a law, or what makes a law of the reference that it is to follow.
Asked = str | AnyTracker | Callable[[SampledReference], AnyTracker]

# Characters of a user's object or error that a refusal quotes.
_QUOTED_CHARACTERS = 300
# A name stands in those of files, which have 255 bytes at the most.
_LONGEST_NAME = 50
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


@contextlib.contextmanager
def users_code(name: str, doing: str) -> Iterator[None]:
    """Turn whatever a user's code raises into a refusal that names the tracker.

    SystemExit among it: the command would end with the tracker's exit code, its result lost.

    Raises:
        ProblemError: "tracker 'name' does this: KindOfError: its text"
    """
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        what = ": ".join(part for part in (type(error).__name__, _text_of(error)) if part)
        raise ProblemError(f"tracker '{name}' {doing}: {what}") from error


def _text_of(thing: object) -> str:
    """Return the beginning of a user's object as one line; its kind where its own text raises."""
    try:
        said = one_line(thing)
    except KeyboardInterrupt:
        raise
    except BaseException:
        said = f"<{type(thing).__name__}>"
    return said if len(said) <= _QUOTED_CHARACTERS else f"{said[:_QUOTED_CHARACTERS]} ..."


def _loaded(text: str, load: Callable[[], Any]) -> Asked:
    with users_code(text, "cannot be loaded"):
        _forget_older(text)
        return load()


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
            ProblemError: when the law raises, or gives anything but one number for each actuator.
        """
        with users_code(self.name, f"fails at control instant {k}"):
            given = self.law.effort(k, position, velocity)
        return _checked(given, self.name, position.shape[:-1], self.actuators)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CheckedMemory:
    """A user's law with a memory, its efforts checked."""

    law: TrackerWithMemory
    name: str
    actuators: tuple[str, ...]

    def start(self, n: int) -> np.ndarray:
        """Return the memory (n, n_m) before the first control instant of n simulations."""
        with users_code(self.name, "cannot start"):
            memory = np.asarray(self.law.start(n))
        if memory.ndim != 2 or len(memory) != n:
            raise ProblemError(f"tracker '{self.name}' starts with a memory of shape ({n}, any), got {memory.shape}")
        return memory

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] and the next memory (n, n_m).

        Raises:
            ProblemError: when the law raises, gives anything but one number for each actuator, or another memory.
        """
        with users_code(self.name, f"fails at control instant {k}"):
            given, after = self.law.step(k, position, velocity, memory)
            after = np.asarray(after)
        if after.shape != memory.shape:
            raise ProblemError(f"tracker '{self.name}' returns a memory of shape {memory.shape}, got {after.shape}")
        return _checked(given, self.name, position.shape[:-1], self.actuators), after


def _checked(given: object, name: str, states: tuple[int, ...], actuators: tuple[str, ...]) -> np.ndarray:
    effort = None
    with contextlib.suppress(ProblemError), users_code(name, "gives no numbers"), warnings.catch_warnings():
        warnings.simplefilter("error")  # of complex numbers numpy drops the imaginary part
        effort = np.array(given, dtype=float)
    wanted = (*states, len(actuators))
    if effort is None or effort.shape != wanted:
        got = _text_of(given) if effort is None else f"shape {effort.shape}"
        raise ProblemError(
            f"tracker '{name}' gives an array of one effort for each actuator ({', '.join(actuators)}),"
            f" shape {wanted}, got {got}"
        )
    return effort


def _is_law(thing: object) -> bool:
    """Return whether a thing is a law: it has effort, or start and step. Attributes are the user's code, too."""
    with users_code(type(thing).__name__, "cannot be used"):
        return _has(thing, "effort") or _has(thing, "start", "step")


def _has(thing: object, *methods: str) -> bool:
    return all(callable(getattr(thing, name, None)) for name in methods)


def knows_batches(law: AnyTracker) -> bool:
    """Return whether a law is asked for many states at once."""
    return isinstance(law, CheckedMemory) or bool(getattr(law, "batched", False))


def users_tracker(asked: object, mechanism: Mechanism, reference: SampledReference) -> CheckedTracker | CheckedMemory:
    """Return a user's tracker for a reference: the law itself, or what a function (or class) makes of the reference.

    Raises:
        ProblemError: when it is no tracker: a name and `effort(k, position, velocity)`, or `start` and `step`.
    """
    law: Any = asked
    made_by = _text_of(getattr(asked, "__name__", type(asked).__name__))
    if isinstance(asked, type) or not _is_law(asked):
        if not callable(asked):
            raise ProblemError(
                f"a tracker is one of {', '.join(TRACKERS)}, an object with a name and effort(k, position, velocity), or a"
                f" function of the sampled reference that returns one; got {_text_of(asked)}"
            )
        with users_code(made_by, "cannot be made"):
            law = asked(reference)
        if not _is_law(law):
            raise ProblemError(
                f"a function that is given as a tracker returns an object with a name and effort(k, position, velocity),"
                f" '{made_by}' returned {_text_of(law)}"
            )
    with users_code(made_by, "cannot be used"):
        name, batched, remembers = getattr(law, "name", None), bool(getattr(law, "batched", False)), not _has(law, "effort")
    if not isinstance(name, str) or not name.strip() or not name.isprintable() or len(name) > _LONGEST_NAME:
        raise ProblemError(
            f"a tracker's name is a word of {_LONGEST_NAME} characters at the most, for tables, figures and files; tracker"
            f" '{made_by}' has {_text_of(name)!r}"
        )
    actuators = tuple(actuator.name for actuator in mechanism.actuators)
    if remembers:
        return CheckedMemory(law=law, name=name, actuators=actuators)
    return CheckedTracker(law=law, name=name, actuators=actuators, batched=batched)
