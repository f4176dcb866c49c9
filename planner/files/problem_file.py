"""Problem files: TOML tables to a `PlanningProblem`, every key checked, every value in range.

Angles are in degrees with `_deg` in the key, positions of slides in metres with `_m`; all else is SI. A built-in name works
wherever a file does.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from linkplan.models.audit import audit
from linkplan.models.catalogue import MODELS, is_file
from linkplan.models.errors import AssemblyError, ModelError, ProblemError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.names import nearest
from linkplan.models.poses.assembly import close_at
from linkplan.planner.files.imperfections_file import imperfections_of
from linkplan.planner.files.joint_values import joint_values
from linkplan.planner.files.limits_file import KEYS as LIMIT_KEYS
from linkplan.planner.files.limits_file import limits_of, motors_of
from linkplan.planner.files.motion_file import KEYS as MOTION_KEYS
from linkplan.planner.files.motion_file import motion_of
from linkplan.planner.files.named_coordinates import coordinates_note, other_coordinates
from linkplan.planner.files.tables import Tables, apply_override, read_tables
from linkplan.planner.files.trajectory_file import read_trajectory
from linkplan.planner.files.values import word
from linkplan.planner.problem.imperfections import KEYS as IMPERFECTIONS
from linkplan.planner.problem.objective import TERMS, Objective, objective_from
from linkplan.planner.problem.planning_problem import CONTACTS, KINDS, GuessedPath, PlanningProblem
from linkplan.planner.problem.reference import Sine
from linkplan.planner.problem.settings import MeshSettings, SolverSettings, Tracking
from linkplan.planner.problem.values import number
from linkplan.planner.trajectory import Trajectory

KEYS: Mapping[str, tuple[str, ...]] = {
    "mechanism": ("model", "payload", "home_deg", "home_m", "independent", "closure_tolerance_m", "solref"),
    "motion": MOTION_KEYS,
    "reference": ("amplitude_deg", "amplitude_m", "bias_deg", "bias_m", "phase_deg", "frequency_hz"),
    "objective": ("minimize",),
    "limits": (*LIMIT_KEYS, "contacts"),
    "motors": (),
    "guess": ("plan", "path_deg", "path_m", "duration_s"),
    "mesh": ("scheme", "intervals", "effort", "tolerance_deg", "refine", "breaks"),
    "solver": ("name", "compile", "max_time_s", "starts"),
    "tracking": (
        "kp",
        "kd",
        "period_s",
        "delay_periods",
        "duration_s",
        "lqr_position_deg",
        "lqr_velocity_deg_s",
        "lqr_position_m",
        "lqr_velocity_m_s",
    ),
    "imperfections": IMPERFECTIONS,
}
# A dependent joint named in start_deg or goal_deg must stand this near to where the closed loop has it.
_POSE_TOLERANCE = np.radians(0.05)


def load_problem(source: str | Path, overrides: Sequence[str] = ()) -> PlanningProblem:
    """Return the problem of a built-in name or a TOML file, with `key=value` overrides applied.

    Raises:
        ProblemError: for anything in the file or an override that cannot be used.
        ModelError: when the mechanism that it names cannot be.
    """
    name, tables, folder = read_tables(source)
    for override in overrides:
        apply_override(tables, override)
    return problem_from_tables(name, tables, folder)


def problem_from_tables(
    name: str, tables: Tables, folder: Path | None = None, mechanism: Mechanism | None = None
) -> PlanningProblem:
    """Return the problem that a file's tables mean.

    Args:
        name: of the problem.
        tables: as `tomllib` reads them; they are not changed.
        folder: the file's, from which paths in it are looked up before the working folder.
        mechanism: one that is loaded already, in place of what [mechanism] says.

    Raises:
        ProblemError: for anything in the tables that cannot be used.
        ModelError: when the mechanism that they name cannot be.
    """
    tables = copy.deepcopy(tables)
    if mechanism is not None:
        tables["mechanism"] = copy.deepcopy(dict(mechanism.source))
    _check_keys(tables)
    if mechanism is None:
        mechanism = _mechanism(tables.setdefault("mechanism", {}), folder)
    section = {key: tables.get(key, {}) for key in KEYS}
    if mechanism.n_u == 0:
        raise ProblemError(
            f"mechanism '{mechanism.name}' has no usable actuator; a plan needs one"
            + "".join(f"; {item.text}" for item in audit(mechanism.model))
        )
    imperfections_of(section["imperfections"], mechanism)  # refused now, though planning knows nothing of them
    notes = []
    others = other_coordinates(section, mechanism)
    if others is not None:
        notes.append(coordinates_note(mechanism, others))
        mechanism = _in_coordinates(tables, mechanism, others, folder)
    kind = word(section["motion"], "motion.kind", KINDS)
    default = "tracking" if kind == "track" or (kind == "periodic" and section["reference"]) else "effort"
    objective = _objective(section["objective"], default)
    reference = _reference(section["reference"], mechanism) if section["reference"] else None
    limits = limits_of(section["limits"], mechanism)
    problem = PlanningProblem(
        name=name,
        mechanism=mechanism,
        motion=motion_of(section["motion"], kind, mechanism, reference, limits),
        objective=objective,
        limits=limits,
        motors=motors_of(section["motors"], mechanism),
        reference=reference,
        guess=_guess(section["guess"], mechanism, folder),
        contacts=word(section["limits"], "limits.contacts", CONTACTS, "refuse"),
        mesh=_mesh(section["mesh"], objective, rated="effort_rate" in section["limits"]),
        solver=SolverSettings(**section["solver"]),
        tracking=_tracking(section["tracking"], mechanism),
        source=tables,
        notes=(*notes, *_duration_notes(section["motion"], objective, reference)),
    )
    _check_poses(section["motion"], problem)
    return problem


def _in_coordinates(tables: Tables, mechanism: Mechanism, named: list[str], folder: Path | None) -> Mechanism:
    """Return a mechanism with other independent coordinates, which the tables then name."""
    tables["mechanism"]["independent"] = named
    try:
        return _mechanism(tables["mechanism"], folder)
    except ModelError as error:
        had = ", ".join(joint.name for joint in mechanism.independent_joints)
        raise ProblemError(
            f"the motion names {', '.join(named)}, in which it cannot be planned; by default it is named in {had}: {error}"
        ) from error


def _duration_notes(section: dict, objective: Objective, reference: Sine | None) -> list[str]:
    """Return the sentence on a duration that is free because nothing is said of it."""
    said = any(key in section for key in ("duration_s", "min_duration_s", "max_duration_s"))
    if said or reference is not None or objective.has("time"):
        return []
    return ['motion.duration_s is not given: the duration is free (give it, or write motion.duration_s = "free")']


def mechanism_from_tables(tables: Tables, folder: Path | None = None) -> Mechanism:
    """Return the mechanism that a file's [mechanism] table means; the other tables are only checked for their keys."""
    tables = copy.deepcopy(tables)
    _check_keys(tables)
    return _mechanism(tables.get("mechanism", {}), folder)


def tracking_from_tables(tables: Tables, mechanism: Mechanism | None = None) -> Tracking:
    """Return the tracking settings of a file's [tracking] table; with a mechanism, gains by joint are checked."""
    _check_keys(tables)
    return _tracking(tables.get("tracking", {}), mechanism)


def _check_keys(tables: Tables) -> None:
    for section, content in tables.items():
        if section == "description" and isinstance(content, str):
            continue
        if section not in KEYS:
            raise ProblemError(f"unknown table or key '{section}'{nearest(section, KEYS)}; tables are {', '.join(KEYS)}")
        if not isinstance(content, dict):
            raise ProblemError(f"'{section}' is a table ([{section}]), got {content!r}")
        for key in content:
            if section != "motors" and key not in KEYS[section]:
                raise ProblemError(
                    f"unknown key '{section}.{key}'{nearest(key, KEYS[section])}; keys are {', '.join(KEYS[section])}"
                )


def _mechanism(section: dict, folder: Path | None) -> Mechanism:
    model = section.get("model")
    if not isinstance(model, str) or not model:
        raise ProblemError(f"mechanism.model is a built-in name or a path to an MJCF file, got {model!r}")
    place = beside(model, folder)
    if model not in MODELS and is_file(place):
        model = str(place.resolve())
    section["model"] = model
    mechanism = load_mechanism(
        model,
        payload=section.get("payload"),
        home=_home(section),
        independent=section.get("independent"),
        solref=section.get("solref"),
        closure_tolerance_m=section.get("closure_tolerance_m"),
    )
    joint_values(section, "home", "mechanism", mechanism)  # refuses degrees for a slide and metres for a hinge
    return replace(mechanism, source=copy.deepcopy(section))


def beside(path: str, folder: Path | None) -> Path:
    """Return a path that a problem file names: from the file's folder, or from the working folder where it is not there."""
    try:
        there = folder is not None and (folder / path).exists()
    except (OSError, ValueError):  # a name that no file can have
        there = False
    return folder / path if folder is not None and there else Path(path)


def _home(section: dict) -> dict[str, float]:
    home = {}
    for key, factor in (("home_deg", np.pi / 180), ("home_m", 1.0)):
        table = section.get(key, {})
        if not isinstance(table, dict):
            raise ProblemError(f"mechanism.{key} is a table of joint = value, got {table!r}")
        for joint, value in table.items():
            home[joint] = factor * number(value, f"mechanism.{key}.{joint}")
    return home


def _reference(section: dict, mechanism: Mechanism) -> Sine:
    def values(key: str, default: float | None) -> np.ndarray:
        found = joint_values(section, key, "reference", mechanism)
        for index in found:
            if index not in mechanism.independent:
                names = ", ".join(j.name for j in mechanism.independent_joints)
                raise ProblemError(
                    f"reference.{key} is for independent joints ({names}), got {mechanism.joints[index].name}"
                )
        result = []
        for index, joint in zip(mechanism.independent, mechanism.independent_joints, strict=True):
            if int(index) not in found and default is None:
                raise ProblemError(f"reference.{key}_{joint.unit} names no value for joint {joint.name}")
            result.append(joint.read(number(found.get(int(index), default), f"reference.{key} of joint {joint.name}")))
        return np.array(result)

    phase = section.get("phase_deg", {})
    if not isinstance(phase, dict):
        raise ProblemError(f"reference.phase_deg is a table of joint = value, got {phase!r}")
    for joint in phase:
        mechanism.joint_index(joint, ProblemError)
    phases = [number(phase.get(j.name, 0.0), f"reference.phase_deg.{j.name}") for j in mechanism.independent_joints]
    return Sine(
        amplitude=values("amplitude", None),
        bias=values("bias", 0.0),
        phase=np.radians(phases),
        frequency_hz=number(section.get("frequency_hz"), "reference.frequency_hz", positive=True),
    )


def _objective(section: dict, default: str) -> Objective:
    wanted = section.get("minimize", default)
    if isinstance(wanted, dict):
        return objective_from({term: number(weight, f"objective.minimize.{term}") for term, weight in wanted.items()})
    return objective_from(word(section, "objective.minimize", tuple(TERMS), default))


def _guess(section: dict, mechanism: Mechanism, folder: Path | None) -> GuessedPath | Trajectory | None:
    """Return the user's own start: a saved plan's motion, or positions at equal times."""
    plan, duration = section.get("plan"), section.get("duration_s")
    duration = None if duration is None else number(duration, "guess.duration_s", positive=True)
    paths = joint_values(section, "path", "guess", mechanism)
    if plan is not None and paths:
        raise ProblemError("guess.plan and guess.path_deg are two guesses; keep one")
    if plan is not None:
        if not isinstance(plan, str) or not plan:
            raise ProblemError(f"guess.plan is a saved plan's folder, got {plan!r}")
        place = beside(plan, folder)
        if not place.is_dir():
            where = "the working folder" if folder is None else f"'{folder}', the problem file's, or the working folder"
            raise ProblemError(f"guess.plan '{plan}' is not a folder in {where}; it is where a plan was saved")
        section["plan"] = str(place.resolve())
        return read_trajectory(place / "trajectory.npz")
    if not paths:
        return None
    columns = []
    for index, joint in zip(mechanism.independent, mechanism.independent_joints, strict=True):
        values = paths.get(int(index))
        if not isinstance(values, list) or len(values) < 2:
            raise ProblemError(f"guess.path_{joint.unit}.{joint.name} is a list of two or more positions, got {values!r}")
        columns.append([joint.read(number(value, f"guess.path_{joint.unit}.{joint.name}")) for value in values])
    if len({len(column) for column in columns}) > 1:
        raise ProblemError("guess.path_deg has equally many positions for every independent joint")
    return GuessedPath(path=np.array(columns).T, duration_s=duration)


def _mesh(section: dict, objective: Objective, *, rated: bool) -> MeshSettings:
    # Least work pushes in full, coasts and brakes in full: a polynomial smears that, and is charged at its nodes alone.
    # Efforts whose rates are limited cannot jump, and bend where these were jumps.
    smeared = objective.has("work") and {*objective.weights} <= {"work", "time"}
    values = {"effort": "linear" if rated else "constant"} if smeared else {}
    if "scheme" in section:
        values["refine"] = "intervals"  # a transcription that was named is kept, unless its degree is given free
    breaks = section.get("breaks")
    if breaks is not None:
        if "intervals" in section:
            raise ProblemError("mesh.breaks and mesh.intervals both say how many intervals there are; keep one")
        values["intervals"] = len(MeshSettings(breaks=breaks).breaks) - 1
    return MeshSettings(**(values | section))


def _tracking(section: dict, mechanism: Mechanism | None) -> Tracking:
    values = dict(section)
    for key, in_file in (("lqr_position", "lqr_position_deg"), ("lqr_velocity", "lqr_velocity_deg_s")):
        if in_file in values:
            values[key] = np.radians(number(values.pop(in_file), f"tracking.{in_file}", positive=True))
    found = Tracking(**values)
    if mechanism is not None:
        found.gains(mechanism.independent_joints)  # refuses joints that have no gain, and gains of no joint
    return found


def _check_poses(section: dict, problem: PlanningProblem) -> None:
    """Refuse a start, goal or waypoint whose dependent joints do not stand where the closed loop has them."""
    mechanism, motion = problem.mechanism, problem.motion
    states = [(section, "motion", "start", motion.start), (section, "motion", "goal", motion.goal)]
    for k, (item, waypoint) in enumerate(zip(section.get("waypoints", []), motion.waypoints, strict=True)):
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
                " one of them free names none that follows"
            )
        try:
            pose = close_at(mechanism, s)
        except AssemblyError as error:
            raise ProblemError(f"{where}.{key}_deg does not close: {error}") from error
        for index in extra:
            joint = mechanism.joints[index]
            asked = joint.read(number(named[index], f"{where}.{key} of joint {joint.name}"))
            if abs(asked - pose[index]) > _POSE_TOLERANCE:
                pairs = zip(mechanism.independent_joints, s, strict=True)
                raise ProblemError(
                    f"{where}.{key}_{joint.unit} does not close: with"
                    f" {', '.join(f'{j.name} = {j.said(x, 6)}' for j, x in pairs)} the loop has {joint.name} at"
                    f" {joint.said(pose[index], 6)} {joint.unit}, asked {joint.said(asked, 6)}"
                )
