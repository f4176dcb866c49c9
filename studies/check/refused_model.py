"""The report of `linkplan check` on a model that cannot be loaded: locked, not assembled, or without inertia."""

from dataclasses import dataclass

from linkplan.models.closure.initial_assembly import home_text
from linkplan.models.errors import InertiaError, LockedError, UnassembledError
from linkplan.studies.output.document import Block, Code, Facts, Text

# The errors of a model that `check` reports as problems instead of bad input.
REFUSED = (InertiaError, LockedError, UnassembledError)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RefusedModel:
    """A report on a model that cannot be loaded, with the text that repairs it, if it is known."""

    name: str
    error: InertiaError | LockedError | UnassembledError

    @property
    def problems(self) -> tuple[str, ...]:
        """The error as a sentence."""
        return (str(self.error),)

    @property
    def notes(self) -> tuple[str, ...]:
        """There are no notes: the text explains the problem."""
        return ()

    def record(self) -> dict:
        """Return the findings by name."""
        said: dict = {"name": self.name, "problems": list(self.problems)}
        if isinstance(self.error, LockedError):
            return said | {"locked": True, "dof": 0, "dof_gained_without": self.error.freed}
        if isinstance(self.error, InertiaError):
            return said | {"locked": False, "dof": self.error.dof}
        return said | {
            "locked": False,
            "dof": None,
            "gap_m": self.error.gap_m,
            "keyframe": self.error.keyframe or None,
        } | self.error.home  # fmt: skip

    def blocks(self) -> list[Block]:
        """Return the findings as a document."""
        found: list[Block] = [
            Text(text=f"{self.name}: no mechanism as it stands"),
            Text(text=f"PROBLEM: {self.error}", tone="bad"),
        ]
        if isinstance(self.error, LockedError):
            found.append(
                Facts(rows=[("locked by", f"{part} (+{more} without it)") for part, more in self.error.freed.items()])
            )
        elif isinstance(self.error, UnassembledError) and self.error.keyframe:
            home = f"[mechanism]\n{home_text(self.error.home)}".rstrip()
            found.append(Code(title="into the model, in place of a keyframe home", text=self.error.keyframe))
            found.append(Code(title="or into the problem file", text=home))
        return found
