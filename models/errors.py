"""The errors that linkplan raises: one tree, rooted at `LinkplanError`.

A message is one line that says what was asked, what is legal and what was got. Errors go from one process to another: what
they carry beside it has a default, which pickle fills in.
"""

from collections.abc import Mapping

# A refusal quotes what it was given; what is longer than this is a file's content and not a name.
_LONGEST = 4000


def one_line(text: object) -> str:
    """Return `text` as one line: white space folded, and what a terminal would obey in place of showing escaped."""
    folded = " ".join(str(text).split())
    said = "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii") for c in folded)
    return said if len(said) <= _LONGEST else f"{said[: _LONGEST // 2]} ... {said[-_LONGEST // 4 :]}"


class LinkplanError(Exception):
    """Anything that linkplan refuses; its text is one line meant for the user, whatever was asked."""

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
    """A mechanism that its closures lock; carries the degrees of freedom that come with leaving each of them out."""

    def __init__(self, message: str, freed: Mapping[str, int] | None = None) -> None:
        LinkplanError.__init__(self, message)
        self.freed = dict(freed or {})


class UnassembledError(AssemblyError):
    """A model whose own pose is none to begin from: a loop does not close from there, or is singular.

    Carries the gap [m] and the nearest closed pose that was found, as a keyframe to write into the model and as the tables
    home_deg and home_m of a problem file; "" and nothing where none was found.
    """

    def __init__(
        self, message: str, gap_m: float = 0.0, keyframe: str = "", home: Mapping[str, Mapping[str, float]] | None = None
    ) -> None:
        LinkplanError.__init__(self, message)
        self.gap_m = gap_m
        self.keyframe = keyframe
        self.home = {key: dict(values) for key, values in (home or {}).items()}


class ProblemError(LinkplanError):
    """A problem file or a value in it that makes no sense."""


class PlanFileError(LinkplanError):
    """A plan folder that cannot be read or written."""


class CertificateError(PlanFileError):
    """A saved plan whose motion does not pass its certificate when it is read."""


class InfeasibleError(LinkplanError):
    """Raised by `Plan.require()` on a plan that is not optimal; carries the plan."""

    def __init__(self, message: str, plan: object = None) -> None:
        LinkplanError.__init__(self, message)
        self.plan = plan
