"""Functions shared by the commands: they read arguments, and refuse them by their names on the command line."""

import argparse
import contextlib
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from linkplan.models.catalogue import MODELS, nearest_source
from linkplan.models.errors import ModelError, PlanFileError, ProblemError
from linkplan.models.extras import load_extra
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import Tables, apply_override, read_tables, refuse_saved_plan
from linkplan.planner.plan import Plan
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import whole
from linkplan.studies.cli.exit_codes import NoMotionError
from linkplan.studies.cli.printing import Progress, show

if TYPE_CHECKING:
    from linkplan.studies.output.document import Block, Report
    from linkplan.studies.tasks.engine import Engine

Value = TypeVar("Value")
# Options for further files in a result's folder.
_WITH_OUTPUT = {"report": "report.html", "parquet": "tables as Parquet", "jumps": "both sides of jumps"}


# What a command says while a whole proof is made.
PROVING = "proving the limits, then looking for the model's own motion for at most a minute"


@contextlib.contextmanager
def naming(option: str) -> Iterator[None]:
    """Put the name of an option before the text of a refusal of its value."""
    try:
        yield
    except (PlanFileError, ProblemError) as error:
        raise type(error)(f"{option}: {error}") from error


def output_folder(arguments: argparse.Namespace) -> Path | None:
    """Return the output folder; an unusable folder is refused before the work starts."""
    if arguments.output is None:
        for option, what in _WITH_OUTPUT.items():
            if getattr(arguments, option, False):
                raise ProblemError(f"--{option} writes {what} into the folder of -o, which is not given; add -o DIR")
        return None
    if not arguments.output:
        raise ProblemError("-o takes a folder, got an empty name")
    if getattr(arguments, "parquet", False):
        load_extra("pyarrow.parquet", "--parquet")
    from linkplan.planner.files.folders import check_target

    target = Path(arguments.output)
    with naming("-o"):
        check_target(target, f"{arguments.command}.json")
    return target


def new_file(arguments: argparse.Namespace) -> Path | None:
    """Return the file of -o; an existing or unwritable file is refused before the work starts."""
    if arguments.output is None:
        return None
    if not arguments.output:
        raise ProblemError("-o takes a file, got an empty name")
    from linkplan.planner.files.single_file import check_new

    target = Path(arguments.output)
    with naming("-o"):
        check_new(target)
    return target


def engine_asked(arguments: argparse.Namespace) -> "Engine":
    """Return the engine for tasks that --workers or --cluster selects."""
    from linkplan.studies.tasks.cluster import engine_of
    from linkplan.studies.tasks.engine import MOST_WORKERS

    if arguments.cluster is not None and arguments.workers is not None:
        raise ProblemError("--workers are processes of this machine and --cluster has its own; say one of them")
    workers = 1 if arguments.workers is None else whole(arguments.workers, "--workers", 1, MOST_WORKERS)
    return engine_of(workers, arguments.cluster)


def deliver(
    arguments: argparse.Namespace,
    target: Path | None,
    said: dict,
    result: "str | Sequence[Block]",
    report: Callable[[ModuleType], "Report"],
    draw: Callable[[Path], object] = lambda _: None,
) -> None:
    """Save a study's record, report and other files into the folder of -o, if there is one, and show the result.

    `report` makes the report with the module `report.reports`, which is loaded for a folder only.
    """
    if target is not None:
        from linkplan.planner.files.folders import write_json, write_whole
        from linkplan.studies.report import reports
        from linkplan.studies.report.render import save_report

        record = f"{arguments.command}.json"

        def write(place: Path) -> None:
            write_json(place / record, said)
            draw(place)
            save_report(report(reports), place, page=arguments.report)

        write_whole(target, write, record)
    show(arguments, said, result)


def sample_again(folder: Path, tracker: str, sample: int) -> str:
    """Return the command that runs a tracker's sample of an experiment again."""
    place = f"sample-{sample}-{tracker}"
    return f"linkplan track {shlex.quote(str(folder))} --sample {sample} --tracker {tracker} --report -o {place}"


def set_all(tables: Tables, settings: Sequence[str]) -> None:
    """Set the keys of --set in a problem's tables."""
    for setting in settings:
        with naming("--set"):
            apply_override(tables, setting)


def poses_asked(arguments: argparse.Namespace, mechanism: Mechanism) -> list[dict[str, float]]:
    """Return the poses of --at-deg: JOINT=ANGLE, separated by commas, or an angle alone for one degree of freedom."""
    poses = []
    for text in arguments.at_deg:
        pose = {}
        for part in text.split(","):
            name, equals, value = part.rpartition("=")
            if not equals and mechanism.dof == 1:
                name = mechanism.independent_joints[0].name
            try:
                number = float(value)
            except ValueError:
                number = np.nan
            again = bool(pose) and not equals  # 'O=1,5': a comma separates joints and is no decimal point
            if not name or again or not np.isfinite(number):
                raise ProblemError(f"--at-deg takes JOINT=ANGLE, an angle in degrees (metres for a slide), got '{text}'")
            joint = mechanism.joints[mechanism.joint_index(name.strip(), ProblemError)]
            if joint.name in pose:
                raise ProblemError(f"--at-deg names joint {joint.name} twice in '{text}'; decimals have a point")
            pose[joint.name] = joint.read(number)
        poses.append(pose)
    return poses


def selection_asked(arguments: argparse.Namespace) -> dict[str, object]:
    """Return the keys of the [mechanism] table that --keep, --fix-base, --lock, --keyframe and --drive set."""
    table: dict[str, object] = {key: names_asked(getattr(arguments, key), f"--{key}") for key in ("keep", "drive")}
    locks = {}
    for text in arguments.lock:
        name, _, value = text.rpartition("=")
        try:
            number = float(value)
        except ValueError:
            raise ProblemError(f"--lock takes JOINT=VALUE, in degrees or metres, got '{text}'") from None
        once(locks, name.strip(), number, "--lock")
    table |= {"lock": locks, "keyframe": arguments.keyframe, "fix_base": arguments.fix_base}
    return {key: value for key, value in table.items() if value}


def once(found: dict[str, Value], joint: str, value: Value, option: str) -> None:
    """Set the value of a joint in `found`, which has none of it yet."""
    if joint in found:
        raise ProblemError(f"{option} names joint {joint} twice; it takes one value for a joint")
    found[joint] = value


def names_asked(text: str | None, option: str) -> list[str]:
    """Return the names of an option, with commas between them; none if it is not given."""
    found = [] if text is None else [name.strip() for name in text.split(",")]
    if not all(found):
        raise ProblemError(f"{option} takes names with commas between them, got '{text}'")
    return found


def tables_of(
    source: str, overrides: Sequence[str], selection: Mapping[str, object] | None = None
) -> tuple[str, dict, Path | None, bool]:
    """Return name, tables and folder of a model or a problem with its options, and True for a problem."""
    path = Path(source)
    is_problem = source in PROBLEMS or (path.suffix == ".toml" and source not in MODELS)
    if is_problem:
        name, tables, folder = read_tables(source)
    else:
        refuse_no_model(source, (*MODELS, *PROBLEMS))
        name, tables, folder = source, {"mechanism": {"model": source}}, None
    set_all(tables, overrides)
    section, asked = tables.get("mechanism", {}), dict(selection or {})
    if isinstance(section.get("lock"), dict) and isinstance(asked.get("lock"), dict):
        asked["lock"] = section["lock"] | asked["lock"]  # --lock adds to the locks of a file
    tables["mechanism"] = {**section, **asked}
    return name, tables, folder, is_problem


def refuse_no_model(source: str, names: Sequence[str] = tuple(MODELS)) -> None:
    """Refuse a source that is neither a built-in name nor a file, and a saved plan."""
    if source in names:
        return
    refuse_saved_plan(source, "model", "give the file of its problem, an MJCF file, or a built-in name (linkplan list)")
    if source in PROBLEMS or not os.path.exists(Path(source)):
        raise ModelError(
            f"unknown model '{source}'{nearest_source(source, names)}: neither a built-in name ({', '.join(names)})"
            " nor a file"
        )


def plan_asked(arguments: argparse.Namespace, say: Progress) -> Plan:
    """Return the plan that the argument PLAN names, if it has a motion.

    Raises:
        NoMotionError: if it has none; the command ends with the reason and exit code 1.
    """
    return with_motion(plan_of(arguments.plan, say, arguments.set, anyway=arguments.anyway))


def with_motion(plan: Plan) -> Plan:
    """Return a plan if it has a motion; else the command ends (`NoMotionError`)."""
    if plan.trajectory is None:
        raise NoMotionError(plan)
    return plan


def plan_of(source: str, say: Progress, overrides: Sequence[str] = (), *, anyway: bool = False) -> Plan:
    """Return the plan of a source: a saved plan, or the plan of a problem, made now."""
    path = Path(source)
    if path.is_file():
        refuse_saved_plan(source, "plan", "name its folder")
    if source in PROBLEMS or path.is_file() or not path.exists():
        if source not in PROBLEMS and not path.is_file():
            raise ProblemError(
                f"unknown plan or problem '{source}'{nearest_source(source, PROBLEMS)}: neither a plan's folder,"
                f" nor a problem file, nor built-in ({', '.join(PROBLEMS)})"
            )
        name, tables, folder = read_tables(source)
        set_all(tables, overrides)
        return plan_motion(Problem.from_tables(name, tables, folder), say)
    for override in overrides:
        if not override.startswith(("tracking.", "imperfections.")):
            raise ProblemError(
                f"--set {override}: a saved plan is fixed; only tracking.* and imperfections.* can be set on it"
            )
    from linkplan.planner.plan_folder import read_plan, unchecked

    plan, note = read_plan(path, overrides, anyway=anyway), unchecked(path)
    if note is not None:
        say.keep(note)
    if not plan.passed:
        say.keep(f"run anyway: {plan.message}")
    return plan
