"""The errors that linkplan raises, all derived from `LinkplanError`, and names in their messages."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence


def one_line(text: object, most: int = 4000) -> str:
    """Return `text` as one line with single spaces and escaped control characters, shortened to about `most` characters."""
    line = escaped(" ".join(str(text).split()))
    return line if len(line) <= most else f"{line[: most // 2]} ... {line[-most // 4 :]}"


def shortened(text: str, most: int) -> str:
    """Return `text`, or its first whole words with "..." in at most `most` characters."""
    return text if len(text) <= most else f"{text[: most - 4].rsplit(None, 1)[0].rstrip(',;:')} ..."


def escaped(text: str) -> str:
    """Return `text` with control characters and surrogates escaped, safe to print on a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii") for c in text)


def shown(text: object, most: int = 200) -> str:
    """Return `text` with control characters and surrogates escaped, shortened to about `most` characters."""
    line = escaped(str(text))
    return line if len(line) <= most else f"{line[: most // 2]}...{line[-most // 4 :]}"


class LinkplanError(Exception):
    """The base of all errors that linkplan raises. Its text is one line for the user.

    Example::

        try:
            linkplan.load_mechanism("no-such-model")
        except linkplan.LinkplanError as error:
            print(error)
    """

    def __init__(self, message: str) -> None:
        Exception.__init__(self, one_line(message))


class MissingPackageError(LinkplanError, ImportError):
    """A feature whose optional package is not installed."""


class ModelError(LinkplanError):
    """An MJCF model, a payload or a name in it that cannot be used."""


class InertiaError(ModelError):
    """A mechanism whose reduced inertia is singular at home: some motion of its joints moves no mass."""

    def __init__(self, message: str, dof: int = 0) -> None:
        LinkplanError.__init__(self, message)
        self.dof = dof


class AssemblyError(ModelError):
    """A pose that does not close the loops, or that cannot be reached on the branch."""


class LockedError(AssemblyError):
    """A mechanism that its closures lock. `freed` holds the degrees of freedom gained by leaving out each closure."""

    def __init__(self, message: str, freed: Mapping[str, int] | None = None) -> None:
        LinkplanError.__init__(self, message)
        self.freed = dict(freed or {})


class UnassembledError(AssemblyError):
    """A model whose own pose cannot be assembled: a loop does not close from there, or the pose is singular.

    `gap_m` is the gap [m]. `keyframe` (MJCF) and `home` (tables home_deg and home_m of a problem file) contain the nearest
    closed pose found; they are empty if none was found.
    """

    def __init__(
        self, message: str, gap_m: float = 0.0, keyframe: str = "", home: Mapping[str, Mapping[str, float]] | None = None
    ) -> None:
        LinkplanError.__init__(self, message)
        self.gap_m = gap_m
        self.keyframe = keyframe
        self.home = {key: dict(values) for key, values in (home or {}).items()}


class ProblemError(LinkplanError):
    """A problem file, or a value in it, that is not valid."""


class GainError(LinkplanError):
    """A feedback law that has no gain which holds a mechanism on its motion."""


class PlanFileError(LinkplanError):
    """A plan folder that cannot be read or written."""


@contextlib.contextmanager
def refusals(what: str, *others: type[Exception], error: type[LinkplanError] = PlanFileError) -> Iterator[None]:
    """Raise errors of the system, and those of the types `others`, as `error` with a text that begins with `what`."""
    try:
        yield
    except (OSError, *others) as refused:
        raise error(f"{what}: {getattr(refused, 'strerror', None) or refused}") from refused


class CertificateError(PlanFileError):
    """A saved plan whose motion fails its certificate when it is read."""


class PlanError(LinkplanError):
    """Raised by `Plan.require()` if no motion passes; `plan` is that plan, and `verdict` the reason as data."""

    def __init__(self, message: str, plan: object = None) -> None:
        LinkplanError.__init__(self, message)
        self.plan = plan

    @property
    def verdict(self) -> object:
        """The plan's verdict; None without a plan."""
        return getattr(self.plan, "verdict", None)


# Other units in a key, and the unit that files use.
_UNITS = {"rad": "deg", "mm": "m", "cm": "m", "ms": "s", "us": "s", "g": "kg", "kw": "w", "khz": "hz", "kn": "n"}


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: "1 joint", "3 joints"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def listed(names: Sequence[str], most: int) -> str:
    """Return names as text; of more than `most`, the first and the number of the others: "a, b and 3 more"."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def nearest(asked: str, legal: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the legal name closest to `asked`, or an empty text if no name is close."""
    match = closest(asked, legal)
    return "" if match is None else f" (did you mean '{match}'?)"


def closest(asked: str, legal: Iterable[str]) -> str | None:
    """Return the legal name closest to `asked`, or None if no name is close.

    A name that differs only in its units comes first. Upper and lower case count as equal.
    """
    folded: dict[str, str] = {}
    for name in legal:
        folded.setdefault(name.casefold(), name)
    in_our_units = "_".join(_UNITS.get(part, part) for part in str(asked).casefold().split("_"))
    if in_our_units in folded:
        return folded[in_our_units]
    import difflib

    matches = difflib.get_close_matches(str(asked).casefold(), list(folded), n=1, cutoff=0.5)
    return folded[matches[0]] if matches else None


def choose(what: str, asked: str, legal: Iterable[str], error: type[Exception] = ModelError) -> str:
    """Return `asked` if it is legal.

    Raises:
        error: if it is not; the message lists the legal values.
    """
    legal = list(legal)
    if asked in legal:
        return asked
    raise error(f"unknown {what} '{asked}'{nearest(asked, legal)}; legal: {', '.join(legal) or 'none'}")
