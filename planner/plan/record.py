"""The record of a plan, `plan.json`."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from msgspec import UNSET, Struct, UnsetType

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.manifest import read_record
from linkplan.planner.files.tables import PHASES_FILE
from linkplan.planner.plan.verdict import Kind, Verdict
from linkplan.planner.problem.extra import Extra
from linkplan.planner.refinement.history import Step

PLAN_FORMAT = 1
# The type of a field that is not read, because it is for people or follows from the motion.
NotRead = Any


class ExtraRecord(Struct, frozen=True):
    """A user's own limit or cost, without its expression; an infinite bound is null."""

    kind: Literal["limit", "cost"]
    name: str
    unit: str
    lower: float | None = None
    upper: float | None = None
    weight: float | None = None


class MeshRecord(Struct, frozen=True):
    """The transcription and the number of intervals of the final mesh."""

    scheme: str | None = None
    intervals: NotRead = None


class PlanRecord(Struct, frozen=True, eq=False, kw_only=True):
    """The record of a plan. Its fields are `plan.json`, which may lack those with a default value.

    Efforts and powers are by actuator, closure forces by closure. `model_from_here` is the path of the model's file relative
    to the plan's folder, and `fingerprint` has a hash of each part of the model.
    """

    format: int
    name: str
    status: Kind
    message: str
    verdict: Verdict | None = None
    objective: float | None = None
    objective_kind: NotRead = None
    duration_s: NotRead = None
    peak_effort: NotRead = None
    peak_power_w: NotRead = None
    peak_motor_power_w: NotRead = None
    peak_brake_power_w: NotRead = None
    peak_closure_force_n: NotRead = None
    effort_limit: NotRead = None
    effort_unit: NotRead = None
    demands: NotRead = None
    certificate: NotRead = None
    proof: dict[str, Any] | None = None
    mesh: MeshRecord = MeshRecord()
    time_s: NotRead = None
    details: Mapping[str, float | None] = {}
    history: tuple[Step, ...] = ()
    notes: NotRead = None
    not_honoured: NotRead = None
    versions: dict[str, str] = {}
    fingerprint: dict[str, str] | None = None
    problem: dict[str, Any]
    extras: list[ExtraRecord] = []
    price: NotRead = UNSET
    model_from_here: str | UnsetType | None = UNSET


def read_plan_record(folder: Path) -> PlanRecord:
    """Return the record of a saved plan.

    Raises:
        PlanFileError: when the folder is not a plan's, or the record is damaged or of another format.
    """
    path = folder / "plan.json"
    if not folder.is_dir():
        raise PlanFileError(f"'{folder}' is not a plan: a plan is a folder with plan.json and trajectory.npz")
    if not path.exists():
        if (folder / PHASES_FILE).is_file():
            names = ", ".join(f"'{one.parent}'" for one in sorted(folder.glob("*/plan.json")))
            raise PlanFileError(f"'{folder}' is a plan in phases: name the folder of one phase, of {names}")
        within = folder / "plan"
        inside = f", as '{within}' is" if (within / "plan.json").is_file() else ""
        raise PlanFileError(
            f"'{folder}' is not a plan: it has no plan.json; a plan is a folder with that and trajectory.npz{inside}"
        )
    saved = read_record(path, PlanRecord)
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
