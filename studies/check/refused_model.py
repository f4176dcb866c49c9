"""The report of `linkplan check` on a model that cannot be loaded: locked, not assembled, or without inertia."""

from typing import Any, cast

from msgspec import UNSET, Struct, UnsetType

from linkplan.models.closure.initial_assembly import home_text
from linkplan.models.errors import InertiaError, LockedError, UnassembledError, counted
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.output.document import Block, Code, Facts, Report, Section, Text
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result

# The errors of a model that `check` reports as problems instead of bad input.
REFUSED = (InertiaError, LockedError, UnassembledError)


class CheckResult(Result):
    """What the reports of `check` have in common; each also has `name`, `problems`, `notes` and `sections`."""

    __slots__ = ()
    record_name = "check"

    @property
    def passed(self) -> bool:
        """Whether there are no faults."""
        return not cast("Any", self).problems

    def sections(self) -> list[Section]:
        """Return the sections of the report."""
        raise NotImplementedError

    def document(self) -> Report:
        """Return the report."""
        own, found = cast("Any", self), counted(len(cast("Any", self).problems), "problem")
        verdict = "no problems found" if self.passed else f"{found} found"
        return report_of(f"Check of {own.name}", verdict, self.passed, self.sections())

    def __repr__(self) -> str:
        own = cast("Any", self)
        return f"{type(self).__name__}({own.name!r}, {len(own.problems)} problems, {len(own.notes)} notes)"


class RefusedModel(CheckResult, Struct, frozen=True, kw_only=True, eq=False):
    """A report on a model that cannot be loaded, with the text that repairs it if it is known.

    For a locked model, `dof_gained_without` has the degrees of freedom that it gains without each part. `gap_m`, `keyframe`
    and the home are those of a model that is not assembled.
    """

    name: str
    problems: tuple[str, ...]
    locked: bool
    dof: int | None = None
    dof_gained_without: dict[str, int] | UnsetType = UNSET
    gap_m: float | UnsetType = UNSET
    keyframe: str | UnsetType | None = UNSET
    home_deg: dict[str, float] | UnsetType = UNSET
    home_m: dict[str, float] | UnsetType = UNSET
    error: Beside[InertiaError | LockedError | UnassembledError] = NOT_READ

    @property
    def notes(self) -> tuple[str, ...]:
        """No notes, because the problem's text explains everything."""
        return ()

    @property
    def mechanism(self) -> None:
        """No mechanism, because the model is refused."""

    @property
    def home(self) -> dict:
        """The nearest closed pose of a model whose own pose does not close, as tables home_deg and home_m."""
        return getattr(self.error, "home", {})

    def summary(self) -> list[Block]:
        """Return all findings, because there are only a few."""
        return self.blocks()

    def sections(self) -> list[Section]:
        """Return the section of the model."""
        return [Section(title=f"Model: {self.name}", blocks=self.blocks())]

    def blocks(self) -> list[Block]:
        """Return the findings as a document."""
        found: list[Block] = [
            Text(text=f"{self.name}: not a valid mechanism"),
            Text(text=f"PROBLEM: {self.error}", tone="bad"),
        ]
        if isinstance(self.error, LockedError):
            found.append(
                Facts(rows=[("locked by", f"{part} (+{more} without it)") for part, more in self.error.freed.items()])
            )
        elif isinstance(self.error, UnassembledError) and self.error.keyframe:
            home = f"[mechanism]\n{home_text(self.error.home)}".rstrip()
            found.append(Code(title="into the model, as its keyframe home", text=self.error.keyframe))
            found.append(Code(title="or into the problem file", text=home))
        return found


def refused_model(name: str, error: InertiaError | LockedError | UnassembledError) -> RefusedModel:
    """Return the report on a model with the error of loading it."""
    said: dict = {}
    if isinstance(error, LockedError):
        said = {"dof": 0, "dof_gained_without": error.freed}
    elif isinstance(error, InertiaError):
        said = {"dof": error.dof}
    else:
        said = {"gap_m": error.gap_m, "keyframe": error.keyframe or None, **error.home}
    locked = isinstance(error, LockedError)
    return RefusedModel(name=name, problems=(str(error),), locked=locked, error=error, **said)
