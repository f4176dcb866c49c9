"""The subject of a study: a mechanism, a problem, or the name or path of either, with poses to analyse; or a plan."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from linkplan.api.reporting import Listener
from linkplan.models.catalogue import MODELS, unknown_source
from linkplan.models.errors import ModelError, PlanError, ProblemError
from linkplan.models.external_forces import loads_of, omitted_forces
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import PHASES_FILE, Tables, apply_override, read_tables, refuse_saved_plan
from linkplan.planner.plan.folder import read_plan, unchecked
from linkplan.planner.plan.phased import PhasedRecord
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.keys.motion import WaypointSection
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import joint_values, number, to_toml_types
from linkplan.planner.search.planning import plan_motion


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Source:
    """The name or path of a mechanism, a problem or a saved plan, with options for reading it.

    `settings` are "section.key=value". `selection` are keys of [mechanism], which replace those of a file. With `anyway` a
    saved plan is read even if it does not pass its certificate. The command line makes a `Source` from its options.
    """

    name: str
    settings: tuple[str, ...] = ()
    selection: Mapping[str, object] = field(default_factory=dict)
    anyway: bool = False

    @property
    def is_problem(self) -> bool:
        """True for a problem, False for a model."""
        return is_problem(self.name)

    def tables(self) -> tuple[str, Tables, Path | None]:
        """Return the name, the tables and the folder of the problem or, with [mechanism] alone, of the model.

        Raises:
            LinkplanError: if there is no such model or problem, or a setting is invalid.
        """
        if self.is_problem:
            return self.with_settings(*read_tables(self.name))
        if self.name not in MODELS and "<" not in self.name:
            remedy = "give the file of its problem, an MJCF file, or a built-in name (linkplan list)"
            refuse_saved_plan(self.name, "model", remedy)
            if not os.path.exists(Path(self.name)):
                raise ModelError(unknown_source("model or problem", self.name, (*MODELS, *PROBLEMS)))
        return self.with_settings(self.name, {"mechanism": {"model": self.name}}, None)

    def with_settings(self, name: str, tables: Tables, folder: Path | None) -> tuple[str, Tables, Path | None]:
        """Return a problem's name, tables and folder with the settings and the selection."""
        for setting in self.settings:
            try:
                apply_override(tables, setting)
            except ProblemError as error:
                raise ProblemError(f"set: {error}") from error
        section, asked = tables.get("mechanism", {}), dict(self.selection)
        if not asked:
            return name, tables, folder
        if isinstance(section.get("lock"), dict) and isinstance(asked.get("lock"), dict):
            asked["lock"] = section["lock"] | asked["lock"]  # the locks of a selection are added to those of a file
        tables["mechanism"] = {**section, **asked}
        return name, tables, folder

    def problem(self) -> Problem:
        """Return the problem.

        Raises:
            LinkplanError: if it cannot be read, or is invalid.
        """
        return Problem.from_tables(*self.with_settings(*read_tables(self.name)))


ProblemLike = Problem | Source | str | Path
AnyProblem = ProblemLike | PhasedProblem
Subject = Mechanism | Problem | Source | str | Path
PlanLike = Plan | Problem | Source | str | Path
AnyPlan = PlanLike | PhasedRecord | PhasedProblem
Poses = Sequence[Mapping[str, float] | float]
SiteForces = Mapping[str, Sequence[float]]
ByParameter = Mapping[str, float]


def source_of(subject: Source | str | Path) -> Source:
    """Return a name or path as a source without settings."""
    return subject if isinstance(subject, Source) else Source(name=str(subject))


def subject_of(subject: Subject) -> tuple[Mechanism, Problem | None]:
    """Return the mechanism of a subject, and its problem or None.

    Raises:
        LinkplanError: if it is neither a mechanism nor a problem, or its file cannot be used.
    """
    return read_subject(subject)[:2]


def read_subject(subject: Subject) -> tuple[Mechanism, Problem | None, dict]:
    """Return the mechanism of a subject, its problem or None, and its table [tracking].

    Raises:
        LinkplanError: if it is neither a mechanism nor a problem, or its file cannot be used.
    """
    if isinstance(subject, Source | str | Path):
        source = source_of(subject)
        name, tables, folder = source.tables()
        if not source.is_problem:
            return mechanism_from_tables(tables, folder), None, tables.get("tracking", {})
        subject = Problem.from_tables(name, tables, folder)
    if isinstance(subject, Problem):
        return subject.mechanism, subject, subject.to_dict().get("tracking", {})
    if isinstance(subject, Mechanism):
        return subject, None, {}
    raise ProblemError(f"the subject must be a mechanism, a Problem, or the name or path of either, got {subject!r}")


def note_forces(mechanism: Mechanism, say: Listener) -> None:
    """Pass notes on forces over time, which are omitted in an exported model, and on loads, which MuJoCo does not apply."""
    note = omitted_forces(mechanism.forces, "in the exported model")
    if note is not None:
        say.keep(note)
    if loads := loads_of(mechanism.model):
        on = ", ".join(load.name for load in loads)
        say.keep(f"the load on {on} is a custom number of the exported model, which MuJoCo does not apply")


def plan_of(plan: PlanLike, say: Listener, doing: str) -> Plan:
    """Return a plan with a motion: as given, saved in a folder, or computed for a problem. `doing` is its use.

    Raises:
        PlanError: if it has no motion; the error has the plan.
        LinkplanError: if it is none of these, or cannot be read.
    """
    problem = problem_of(plan)
    if problem is not None:
        return with_motion(plan_motion(problem, say), doing)
    return with_motion(_saved_plan(source_of(plan), say) if isinstance(plan, Source | str | Path) else plan, doing)


def given_problem(problem: object) -> Problem:
    """Return a problem: itself, or that of a name or path.

    Raises:
        LinkplanError: if it is none of these, or cannot be read.
    """
    if isinstance(problem, Source):
        return problem.problem()
    if isinstance(problem, str | Path):
        return Problem.from_file(problem)
    if not isinstance(problem, Problem):
        raise ProblemError(f"the problem must be a Problem, a built-in problem's name or a TOML file, got {problem!r}")
    return problem


def given_phases(problem: object) -> PhasedProblem | None:
    """Return a problem in phases: itself, or that of a file with [[phases]]; None for another problem.

    Raises:
        LinkplanError: if the file cannot be read.
    """
    if isinstance(problem, PhasedProblem):
        return problem
    if not isinstance(problem, Source | str | Path):
        return None
    source = source_of(problem)
    if not source.is_problem:
        return None
    name, tables, folder = read_tables(source.name)
    if "phases" not in tables:
        return None
    return PhasedProblem.from_tables(*source.with_settings(name, tables, folder))


def any_plan_of(plan: AnyPlan, say: Listener, doing: str) -> Plan | PhasedRecord:
    """Return a plan with a motion, as `plan_of`, or a plan in phases.

    Raises:
        LinkplanError: if it is neither, has no motion, or cannot be read.
    """
    return _in_phases(plan, say) or plan_of(cast(PlanLike, plan), say, doing)


def _in_phases(plan: AnyPlan, say: Listener) -> PhasedRecord | None:
    """Return a plan in phases: as given, saved in a folder, or computed for a problem with [[phases]]; None for others."""
    if isinstance(plan, PhasedRecord):
        return plan
    if isinstance(plan, Source | str | Path) and (folder := Path(source_of(plan).name)).is_dir():
        from linkplan.studies.output.phased_plan import PhasedPlan

        return PhasedPlan.read(folder) if (folder / PHASES_FILE).is_file() else None
    asked = given_phases(plan)
    if asked is None:
        return None
    from linkplan.planner.search.phases import plan_phases

    return plan_phases(asked, say)


def problem_of(plan: PlanLike) -> Problem | None:
    """Return the problem to be planned; None for a plan or a saved plan.

    Raises:
        LinkplanError: if the problem cannot be read, or there is neither a problem nor a folder.
    """
    if not isinstance(plan, Source | str | Path):
        return plan if isinstance(plan, Problem) else None
    source = source_of(plan)
    path = Path(source.name)
    if os.path.isfile(path):
        refuse_saved_plan(source.name, "plan", "name its folder")
    elif source.name not in PROBLEMS:
        if os.path.exists(path):
            return None
        raise ProblemError(unknown_source("plan or problem", source.name, PROBLEMS))
    return source.problem()


def _saved_plan(source: Source, say: Listener) -> Plan:
    for setting in source.settings:
        if not setting.startswith(("tracking.", "imperfections.")):
            raise ProblemError(
                f"set {setting}: a saved plan cannot be changed; only tracking.* and imperfections.* can be set for it"
            )
    plan, note = read_plan(source.name, source.settings, anyway=source.anyway), unchecked(source.name)
    if note is not None:
        say.keep(note)
    if not plan.passed:
        say.keep(f"run anyway: {plan.message}")
    return plan


def is_problem(name: str | Path) -> bool:
    """Tell if a name or path is that of a problem, not of a model."""
    text = str(name)
    return text in PROBLEMS or (text not in MODELS and Path(text[:255]).suffix == ".toml")


def with_motion(plan: object, doing: str) -> Plan:
    """Return a plan if it has a motion. `doing` is its use.

    Raises:
        PlanError: if it has no motion; the error has the plan.
        ProblemError: if it is not a plan.
    """
    if not isinstance(plan, Plan):
        raise ProblemError(f"to {doing}, give a Plan, a problem, or the name of either, got {plan!r}")
    if plan.trajectory is None:
        raise PlanError(f"cannot {doing}: the plan has no motion: {plan.message}", plan)
    return plan


def listed(trackers: object, legal: str) -> Sequence:
    """Return trackers if they are a list; `legal` describes its entries in the error message."""
    if isinstance(trackers, str) or not isinstance(trackers, Sequence):
        raise ProblemError(f"trackers must be a list of {legal}, got {trackers!r}")
    return trackers


def tracking_table(own: Mapping, tracking: object) -> dict:
    """Return a table [tracking] with some of its settings replaced.

    Raises:
        ProblemError: if the settings are not a table.
    """
    if tracking is not None and not isinstance(tracking, Mapping):
        raise ProblemError(f"tracking must be a table of key = value, got {tracking!r}")
    return {**own, **to_toml_types(tracking or {})}


def poses_of(mechanism: Mechanism, at_deg: object, at_m: object = ()) -> list[dict[str, float]]:
    """Return poses as positions [rad or m] by joint name; `at_deg` and `at_m` are lists of tables of joint = value.

    For one degree of freedom a pose may be a single number.

    If both are given, tables at the same index belong to one pose.

    Raises:
        ProblemError: for an invalid value, or a joint that the mechanism does not have.
    """
    lists = {key: _tables(key, value, mechanism) for key, value in (("at_deg", at_deg), ("at_m", at_m))}
    if lists["at_deg"] and lists["at_m"] and len(lists["at_deg"]) != len(lists["at_m"]):
        raise ProblemError(
            f"at_deg and at_m must have the same number of poses, got {len(lists['at_deg'])} and {len(lists['at_m'])}"
        )
    poses = []
    for k in range(max(map(len, lists.values()))):
        where = f"poses[{k}]"
        given = {key: tables[k] for key, tables in lists.items() if tables}
        values = joint_values(read(WaypointSection, given, where), "at", where, mechanism)
        poses.append({mechanism.joints[i].name: mechanism.joints[i].read(value) for i, value in values.items()})
    return poses


def numbers(values: object, key: str, *, positive: bool = False) -> list[float]:
    """Return one or several numbers as a list; `key` names them in error messages.

    Raises:
        ProblemError: for anything else, or for a number that must be positive and is not.
    """
    given = to_toml_types(values)
    return [number(value, key, positive=positive) for value in (given if isinstance(given, list) else [given])]


def _tables(key: str, value: object, mechanism: Mechanism) -> list[dict]:
    """Return a list of tables.

    A single table becomes a list of one; a number is the position of the only independent joint.
    """
    value = [value] if isinstance(value, Mapping) else value
    value = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
    if isinstance(value, list) and mechanism.dof == 1:
        joint = mechanism.independent_joints[0]
        value = [{joint.name: item} if isinstance(item, int | float) else item for item in value]
    if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
        raise ProblemError(f"{key} must be a list of poses, each a table of joint = value, got {value!r}")
    return [to_toml_types(item) for item in value]
