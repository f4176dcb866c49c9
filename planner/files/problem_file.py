"""Conversion of a problem file's TOML tables to a `PlanningProblem`, with every key and value checked.

Angles are in degrees with `_deg` in the key, positions of slides in metres with `_m`; all else is SI. Every function that
takes a file also takes a built-in name.
"""

import copy
import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from linkplan.models.audit import audit
from linkplan.models.catalogue import MODELS, is_file, is_folder
from linkplan.models.errors import AssemblyError, ModelError, ProblemError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.tree.sites import site_index
from linkplan.planner.files.imperfections_file import imperfections_of
from linkplan.planner.files.joint_values import joint_values
from linkplan.planner.files.limits_file import actuator_index, closure_index, limits_of, motors_of, robust_of
from linkplan.planner.files.motion_file import motion_of
from linkplan.planner.files.named_coordinates import coordinates_note, other_coordinates
from linkplan.planner.files.tables import Tables, apply_override, read_tables
from linkplan.planner.files.toml_text import toml_text
from linkplan.planner.files.trajectory_file import read_trajectory
from linkplan.planner.keys.limits_section import LimitsSection, RobustSection
from linkplan.planner.keys.motion_section import MotionSection, ReferenceSection
from linkplan.planner.keys.reading import kind_of, read, read_section, refuse_unknown_keys
from linkplan.planner.keys.sections import (
    GuessSection,
    MechanismSection,
    MeshSection,
    ObjectiveSection,
    SolverSection,
    TrackingSection,
)
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit, extras_text
from linkplan.planner.problem.objective import Objective, objective_from
from linkplan.planner.problem.planning_problem import GuessedPath, PlanningProblem
from linkplan.planner.problem.reference import Sine
from linkplan.planner.problem.settings import MeshSettings, SolverSettings, Tracking
from linkplan.planner.problem.values import plain

# Sections whose keys are arguments of settings or of the objective, which choose the defaults.
_SETTINGS_SECTIONS = {
    "objective": ObjectiveSection,
    "mesh": MeshSection,
    "solver": SolverSection,
    "tracking": TrackingSection,
}
# Largest difference of a dependent joint named in start_deg or goal_deg from the closed loop's position.
_POSE_TOLERANCE = np.radians(0.05)


def load_problem(source: str | Path, overrides: Sequence[str] = ()) -> PlanningProblem:
    """Return the problem of a built-in name or a TOML file, with `key=value` overrides applied.

    Raises:
        ProblemError: for anything in the file or an override that cannot be used.
        ModelError: when its mechanism cannot be built.
    """
    name, tables, folder = read_tables(source)
    for override in overrides:
        apply_override(tables, override)
    return problem_from_tables(name, tables, folder)


def problem_from_tables(
    name: str,
    tables: Tables,
    folder: Path | None = None,
    mechanism: Mechanism | None = None,
    *,
    extra_costs: Sequence[ExtraCost] = (),
    extra_limits: Sequence[ExtraLimit] = (),
) -> PlanningProblem:
    """Return the problem described by a file's tables.

    Args:
        name: the problem's name.
        tables: as `tomllib` reads them; they are not changed.
        folder: the file's folder, in which paths are looked up before the working folder.
        mechanism: a loaded mechanism that replaces [mechanism].
        extra_costs: running costs as expressions, which tables cannot hold.
        extra_limits: path limits as expressions.

    Raises:
        ProblemError: for anything in the tables that cannot be used.
        ModelError: when their mechanism cannot be built.
    """
    tables = plain(tables)
    if mechanism is not None:
        tables["mechanism"] = copy.deepcopy(dict(mechanism.source))
    refuse_unknown_keys(tables)
    if mechanism is None:
        mechanism = _mechanism(tables.setdefault("mechanism", {}), folder)
    if mechanism.n_u == 0:
        raise ProblemError(
            f"mechanism '{mechanism.name}' has no usable actuator; a plan needs one"
            + "".join(f"; {item.text}" for item in audit(mechanism.model))
        )
    known = functools.partial(_refuse_unknown_name, mechanism)
    asked = read_section(MotionSection, tables, "motion", known)
    sine = read_section(ReferenceSection, tables, "reference", known) if tables.get("reference", {}) != {} else None
    limited = read_section(LimitsSection, tables, "limits", known)
    uncertain = read_section(RobustSection, tables, "robust", known)
    motors = read(kind_of("motors"), tables.get("motors", {}), "motors", known)
    guess = read_section(GuessSection, tables, "guess", known)
    for section, kind in _SETTINGS_SECTIONS.items():
        if tables.get(section) != {"minimize": {}}:  # an empty table is legal only with extra costs; `Objective` checks it
            read_section(kind, tables, section)
    imperfections_of(tables.get("imperfections", {}), mechanism)  # checked here, although planning does not use them
    notes = []
    others = other_coordinates(tables, mechanism)
    if others is not None:
        notes.append(coordinates_note(mechanism, others))
        mechanism = _in_coordinates(tables, mechanism, others, folder)
    default = "tracking" if asked.kind == "track" or (asked.kind == "periodic" and sine is not None) else "effort"
    objective = objective_from(tables.get("objective", {}).get("minimize", default), extra_costs)
    reference = None if sine is None else _reference(sine, mechanism)
    limits = limits_of(limited, mechanism)
    problem = PlanningProblem(
        name=name,
        mechanism=mechanism,
        motion=motion_of(asked, mechanism, reference, limits),
        objective=objective,
        limits=limits,
        extra_limits=extra_limits,
        robust=robust_of(uncertain, mechanism),
        motors=motors_of(motors, mechanism),
        reference=reference,
        guess=_guess(guess, tables, mechanism, folder),
        contacts=limited.contacts,
        unhonoured=limited.unhonoured,
        mesh=MeshSettings(**_mesh(tables.get("mesh", {}), objective, rated="effort_rate" in tables.get("limits", {}))),
        solver=SolverSettings(**tables.get("solver", {})),
        tracking=_tracking(tables.get("tracking", {}), mechanism),
        source=tables,
        notes=(*notes, *_duration_notes(asked, objective, reference)),
    )
    _check_poses(asked, problem)
    return problem


def file_text(problem: PlanningProblem, tables: Tables | None = None) -> str:
    """Return a problem, or other tables, as a file's text; a comment names extra limits and costs, which files cannot hold.

    Raises:
        ProblemError: for a value that TOML cannot express.
    """
    text = toml_text(problem.source if tables is None else tables)
    return f"# Without {extras_text(problem.extras)}: a problem file holds no Python.\n{text}" if problem.extras else text


def _refuse_unknown_name(mechanism: Mechanism, noun: str, name: str, where: str) -> None:
    """Refuse a name of a joint, actuator, closure or site that the mechanism does not have."""
    if noun == "joint":
        mechanism.joint_index(name, ProblemError)
    elif noun == "site":
        if name not in [joint.name for joint in mechanism.joints]:  # a joint's name gets its own message elsewhere
            site_index(mechanism.model, name, where, ProblemError)
    elif noun == "closure":
        closure_index(mechanism, name)
    else:
        actuator_index(mechanism, name, where)


def _in_coordinates(tables: Tables, mechanism: Mechanism, named: list[str], folder: Path | None) -> Mechanism:
    """Return a mechanism with other independent coordinates, and set them in the tables."""
    tables["mechanism"]["independent"] = named
    try:
        return _mechanism(tables["mechanism"], folder)
    except ModelError as error:
        had = ", ".join(joint.name for joint in mechanism.independent_joints)
        raise ProblemError(
            f"the motion names {', '.join(named)}, in which it cannot be planned; by default it is named in {had}: {error}"
        ) from error


def _duration_notes(motion: MotionSection, objective: Objective, reference: Sine | None) -> list[str]:
    """Return a note if the duration is free by default."""
    is_given = any(value is not None for value in (motion.duration_s, motion.min_duration_s, motion.max_duration_s))
    if is_given or reference is not None or objective.has("time"):
        return []
    return ['motion.duration_s is not given: the duration is free (give it, or write motion.duration_s = "free")']


def mechanism_from_tables(tables: Tables, folder: Path | None = None) -> Mechanism:
    """Return the mechanism of a file's [mechanism] table; the other tables are only checked for unknown keys."""
    tables = plain(tables)
    refuse_unknown_keys(tables)
    return _mechanism(tables.get("mechanism", {}), folder)


def tracking_from_tables(tables: Tables, mechanism: Mechanism | None = None) -> Tracking:
    """Return the tracking settings of a file's [tracking] table; with a mechanism, gains by joint are checked."""
    tables = plain(tables)
    refuse_unknown_keys(tables)
    read_section(TrackingSection, tables, "tracking")
    return _tracking(tables.get("tracking", {}), mechanism)


def _mechanism(section: dict, folder: Path | None) -> Mechanism:
    # Errors in the model's place and pose are problem errors; all others are model errors.
    read(MechanismSection, {key: section[key] for key in ("model", "home_deg", "home_m") if key in section}, "mechanism")
    asked = read(MechanismSection, section, "mechanism", error=ModelError)
    place = path_beside(asked.model, folder)
    if asked.model not in MODELS and is_file(place):
        section["model"] = str(place.resolve())
    mechanism = load_mechanism(
        section["model"],
        payload=section.get("payload"),
        home={name: np.radians(angle) for name, angle in asked.home_deg.items()} | asked.home_m,
        independent=asked.independent,
        solref=asked.solref,
        closure_tolerance_m=asked.closure_tolerance_m,
        friction_transition=None if asked.friction_transition_deg_s is None else np.radians(asked.friction_transition_deg_s),
    )
    joint_values(asked, "home", "mechanism", mechanism)  # refuses degrees for a slide and metres for a hinge
    return replace(mechanism, source=copy.deepcopy(section))


def path_beside(path: str, folder: Path | None) -> Path:
    """Return a path in a problem file, relative to the file's folder if it exists there, else to the working folder."""
    try:
        there = folder is not None and (folder / path).exists()
    except (OSError, ValueError):  # an impossible file name
        there = False
    return folder / path if folder is not None and there else Path(path)


def _reference(section: ReferenceSection, mechanism: Mechanism) -> Sine:
    def values(key: str, default: float | None) -> np.ndarray:
        found = joint_values(section, key, "reference", mechanism)
        for index in found:
            if index not in mechanism.independent:
                names = ", ".join(j.name for j in mechanism.independent_joints)
                raise ProblemError(
                    f"reference.{key} is for independent joints ({names}), got {mechanism.joints[index].name}"
                )
        result = []
        for index, joint in zip(mechanism.independent.tolist(), mechanism.independent_joints, strict=True):
            value = found.get(index, default)
            if value is None:
                raise ProblemError(f"reference.{key}_{joint.unit} names no value for joint {joint.name}")
            result.append(joint.read(value))
        return np.array(result)

    for joint in section.phase_deg:
        mechanism.joint_index(joint, ProblemError)
    return Sine(
        amplitude=values("amplitude", None),
        bias=values("bias", 0.0),
        phase=np.radians([section.phase_deg.get(joint.name, 0.0) for joint in mechanism.independent_joints]),
        frequency_hz=section.frequency_hz,
    )


def _guess(section: GuessSection, tables: Tables, mechanism: Mechanism, folder: Path | None):
    """Return the user's initial guess, a saved plan's motion or equidistant positions; None without a guess."""
    paths = joint_values(section, "path", "guess", mechanism)
    if section.plan is not None and paths:
        raise ProblemError("guess.plan and guess.path_deg are two guesses; keep one")
    if section.plan is not None:
        place = path_beside(section.plan, folder)
        if not is_folder(place):
            where = "the working folder" if folder is None else f"'{folder}', the problem file's, or the working folder"
            raise ProblemError(f"guess.plan '{section.plan}' is not a folder in {where}; it is where a plan was saved")
        tables["guess"]["plan"] = str(place.resolve())
        return read_trajectory(place / "trajectory.npz")
    if not paths:
        return None
    columns = []
    for index, joint in zip(mechanism.independent.tolist(), mechanism.independent_joints, strict=True):
        if index not in paths:
            raise ProblemError(f"guess.path_{joint.unit} names no list of positions for joint {joint.name}")
        columns.append([joint.read(value) for value in paths[index]])
    if len({len(column) for column in columns}) > 1:
        raise ProblemError("guess.path_deg has equally many positions for every independent joint")
    return GuessedPath(path=np.array(columns).T, duration_s=section.duration_s)


def _mesh(section: dict, objective: Objective, *, rated: bool) -> dict:
    """Return the mesh settings, with defaults that depend on the rest of the problem."""
    # Least work has full effort, coasting and full braking. A polynomial smears this, and its cost is evaluated at nodes
    # only. Efforts with limited rates cannot jump, so they are piecewise linear.
    smeared = objective.has("work") and {*objective.weights} <= {"work", "time"}
    values: dict = {"effort": "linear" if rated else "constant"} if smeared else {}
    if "scheme" in section:
        values["refine"] = "intervals"  # keeps the named transcription, unless its refinement is given too
    if "breaks" in section:
        if "intervals" in section:
            raise ProblemError("mesh.breaks and mesh.intervals both say how many intervals there are; keep one")
        values["intervals"] = len(section["breaks"]) - 1
    return values | section


def _tracking(section: dict, mechanism: Mechanism | None) -> Tracking:
    values = dict(section)
    for key, in_file in (("lqr_position", "lqr_position_deg"), ("lqr_velocity", "lqr_velocity_deg_s")):
        if in_file in values:
            values[key] = np.radians(values.pop(in_file))
    found = Tracking(**values)
    if mechanism is not None:
        found.gains(mechanism.independent_joints)  # refuses joints without a gain, and gains of unknown joints
    return found


def _check_poses(section: MotionSection, problem: PlanningProblem) -> None:
    """Refuse a start, goal or waypoint with dependent joints that are not where the closed loop has them."""
    mechanism, motion = problem.mechanism, problem.motion
    states: list[tuple] = [(section, "motion", "start", motion.start), (section, "motion", "goal", motion.goal)]
    for k, (item, waypoint) in enumerate(zip(section.waypoints, motion.waypoints, strict=True)):
        states.append((item, f"motion.waypoints[{k}]", "at", waypoint.position))
    for table, where, key, s in states:
        named = joint_values(table, key, where, mechanism)
        extra = [index for index in named if index not in mechanism.independent]
        if s is None or not extra:
            continue
        if np.any(np.isnan(s)):
            names = ", ".join(joint.name for joint in mechanism.independent_joints)
            raise ProblemError(
                f"{where}.{key} of joint {mechanism.joints[extra[0]].name}: it follows from {names}; a waypoint that leaves"
                " one of them free must not name dependent joints"
            )
        try:
            pose = close_at(mechanism, s)
        except AssemblyError as error:
            raise ProblemError(f"{where}.{key}_deg does not close: {error}") from error
        for index in extra:
            joint = mechanism.joints[index]
            asked = joint.read(named[index])
            if abs(asked - pose[index]) > _POSE_TOLERANCE:
                pairs = zip(mechanism.independent_joints, s, strict=True)
                raise ProblemError(
                    f"{where}.{key}_{joint.unit} does not close: with"
                    f" {', '.join(f'{j.name} = {j.said(x, 6)}' for j, x in pairs)} the loop has {joint.name} at"
                    f" {joint.said(pose[index], 6)} {joint.unit}, asked {joint.said(asked, 6)}"
                )
