"""The errors that linkplan raises: one tree, rooted at `LinkplanError`.

A message is one line that says what was asked, what is legal and what was got.
"""

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


class ModelError(LinkplanError):
    """An MJCF model, a payload or a name in it that cannot be used."""


class AssemblyError(ModelError):
    """A pose that does not close the loops, or that cannot be reached on the branch."""


class ProblemError(LinkplanError):
    """A problem file or a value in it that makes no sense."""


class PlanFileError(LinkplanError):
    """A plan folder that cannot be read or written."""


class CertificateError(PlanFileError):
    """A saved plan whose motion does not pass its certificate when it is read."""


class InfeasibleError(LinkplanError):
    """Raised by `Plan.require()` on a plan that is not optimal; carries the plan."""

    def __init__(self, message: str, plan: object) -> None:
        LinkplanError.__init__(self, message)
        self.plan = plan
