"""The subject of a study: a mechanism, a problem, or the name or path of either, with poses to analyse; or a plan."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.keys.motion_and_limits import WaypointSection
from linkplan.planner.keys.reading import read
from linkplan.planner.plan import Plan
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.imperfections import imperfections_of
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import joint_values, number, plain

Subject = Mechanism | Problem | str | Path


def subject_of(subject: Subject) -> tuple[Mechanism, Problem | None]:
    """Return the mechanism of a subject, and its problem or None.

    Raises:
        LinkplanError: if it is neither a mechanism nor a problem, or its file cannot be used.
    """
    if isinstance(subject, str | Path):
        if not is_problem(subject):
            return mechanism_from_tables({"mechanism": {"model": str(subject)}}), None
        subject = Problem.from_file(subject)
    if isinstance(subject, Problem):
        return subject.mechanism, subject
    if isinstance(subject, Mechanism):
        return subject, None
    raise ProblemError(f"a study is asked about a mechanism, a Problem, or the name or path of either, got {subject!r}")


def is_problem(name: str | Path) -> bool:
    """Tell if a name or path is that of a problem, not of a model."""
    return str(name) in PROBLEMS or Path(str(name)[:255]).suffix == ".toml"


def with_motion(plan: object, doing: str) -> Plan:
    """Return a plan if it has a motion; `doing` says what for.

    Raises:
        LinkplanError: if it is no plan, or has no motion.
    """
    if not isinstance(plan, Plan):
        raise ProblemError(f"a Plan is needed to {doing}, got {plan!r}")
    plan.require_motion(doing)
    return plan


def with_imperfections(plan: Plan, imperfections: Mapping | None) -> Plan:
    """Return a plan whose problem has another table [imperfections], if one is given.

    Raises:
        ProblemError: for a key, name, or value that cannot be used.
    """
    if imperfections is None:
        return plan
    problem, table = plan.problem, plain(imperfections)
    imperfections_of(table, problem.mechanism)
    return replace(plan, problem=replace(problem, source={**problem.source, "imperfections": table}))


def listed(trackers: object, legal: str) -> Sequence:
    """Return trackers if they are a list; `legal` says of what."""
    if isinstance(trackers, str) or not isinstance(trackers, Sequence):
        raise ProblemError(f"trackers are a list of {legal}, got {trackers!r}")
    return trackers


def tracking_table(problem: Problem | None, tracking: object) -> dict:
    """Return the table [tracking] of a problem, with other settings in place of its own.

    Raises:
        ProblemError: if the settings are no table.
    """
    if tracking is not None and not isinstance(tracking, Mapping):
        raise ProblemError(f"tracking is a table of key = value, got {tracking!r}")
    return ({} if problem is None else problem.to_dict().get("tracking", {})) | plain(tracking or {})


def poses_of(mechanism: Mechanism, at_deg: object, at_m: object = ()) -> list[dict[str, float]]:
    """Return poses as positions [rad or m] by joint name; `at_deg` and `at_m` are lists of tables of joint = value.

    If both are given, tables at the same index belong to one pose.

    Raises:
        ProblemError: for an invalid value, or a joint that the mechanism does not have.
    """
    lists = {key: _tables(key, value) for key, value in (("at_deg", at_deg), ("at_m", at_m))}
    if lists["at_deg"] and lists["at_m"] and len(lists["at_deg"]) != len(lists["at_m"]):
        raise ProblemError(
            f"at_deg and at_m have a table each for every pose, got {len(lists['at_deg'])} and {len(lists['at_m'])}"
        )
    poses = []
    for k in range(max(map(len, lists.values()))):
        where = f"poses[{k}]"
        given = {key: tables[k] for key, tables in lists.items() if tables}
        values = joint_values(read(WaypointSection, given, where), "at", where, mechanism)
        poses.append({mechanism.joints[i].name: mechanism.joints[i].read(value) for i, value in values.items()})
    return poses


def numbers(values: object, key: str, *, positive: bool = False) -> list[float]:
    """Return one number or several as a list; `key` names them in refusals.

    Raises:
        ProblemError: for something else, or a number that is not positive if it should be.
    """
    given = plain(values)
    return [number(value, key, positive=positive) for value in (given if isinstance(given, list) else [given])]


def _tables(key: str, value: object) -> list[dict]:
    """Return a list of tables; a single table counts as a list of one."""
    value = [value] if isinstance(value, Mapping) else value
    value = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
    if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
        raise ProblemError(f"{key} is a list of poses, each a table of joint = value, got {value!r}")
    return [plain(item) for item in value]
