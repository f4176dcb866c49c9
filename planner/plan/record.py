"""The part of a saved plan's record, `plan.json`, that is read back."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, structs

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.manifest import read_record
from linkplan.planner.plan.plan import STATUSES
from linkplan.planner.problem.extra import Extra
from linkplan.planner.refinement.history import Step

PLAN_FORMAT = 1
_Count = Annotated[int, Meta(ge=0)]
_Seconds = Annotated[float, Meta(ge=0)]


class StepRecord(Struct, frozen=True):
    """One solve of a plan's history: the saved fields of `Step`; an objective that is not a number is null."""

    what: str
    scheme: str
    intervals: _Count
    segments: _Count
    converged: bool
    solver_status: str
    objective: float | None
    integration_error_deg: float | None
    build_s: _Seconds
    solve_s: _Seconds
    integration_error: float | None = None


class ExtraRecord(Struct, frozen=True):
    """A user's own limit or cost, without its expression; an infinite bound is null."""

    kind: Literal["limit", "cost"]
    name: str
    unit: str
    lower: float | None = None
    upper: float | None = None
    weight: float | None = None


class MeshRecord(Struct, frozen=True):
    """The final mesh's transcription; its intervals follow from the motion."""

    scheme: str | None = None


class PlanRecord(Struct, frozen=True):
    """The fields of `plan.json` that are read; the others are for people, or follow from the motion."""

    format: int
    name: str
    status: str
    message: str
    problem: dict[str, Any]
    objective: float | None = None
    mesh: MeshRecord = MeshRecord()
    details: dict[str, float | None] = {}
    history: list[StepRecord] = []
    versions: dict[str, str] = {}
    fingerprint: dict[str, str] | None = None
    model_from_here: str | None = None
    extras: list[ExtraRecord] = []
    proof: dict[str, Any] | None = None


def read_plan_record(folder: Path) -> PlanRecord:
    """Return the record of a saved plan.

    Raises:
        PlanFileError: when the folder is not a plan's, or the record is damaged or of another format.
    """
    path = folder / "plan.json"
    if not folder.is_dir():
        raise PlanFileError(f"'{folder}' is not a plan: a plan is a folder with plan.json and trajectory.npz")
    if not path.exists():
        within = folder / "plan"
        inside = f", as '{within}' is" if (within / "plan.json").is_file() else ""
        raise PlanFileError(
            f"'{folder}' is not a plan: it has no plan.json; a plan is a folder with that and trajectory.npz{inside}"
        )
    saved = read_record(path, PlanRecord)
    if saved.status not in STATUSES:
        raise PlanFileError(f"'{path}' has status '{saved.status}'; a plan's is one of {', '.join(STATUSES)}")
    if saved.format != PLAN_FORMAT:
        raise PlanFileError(f"'{path}' has format {saved.format}; this linkplan reads {PLAN_FORMAT}")
    return saved


def extra_records(extras: Sequence[Extra]) -> list[ExtraRecord]:
    """Return the records of users' own limits and costs."""
    found = []
    for one in extras:
        numbers = {name: getattr(one, name, math.inf) for name in ("lower", "upper", "weight")}
        finite = {name: value for name, value in numbers.items() if math.isfinite(value)}
        found.append(ExtraRecord(kind=one.kind, name=one.name, unit=one.unit, **finite))
    return found


def history_of(saved: PlanRecord) -> tuple[Step, ...]:
    """Return the solves of a saved plan's history."""
    rows = (structs.asdict(row) for row in saved.history)
    return tuple(Step(**{**row, "objective": math.nan if row["objective"] is None else row["objective"]}) for row in rows)
