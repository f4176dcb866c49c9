"""Problem files: TOML tables to a `PlanningProblem`, every key checked, every value in range.

Angles are in degrees with `_deg` in the key, positions of slides in metres with `_m`; all else is SI. A built-in name works
wherever a file does.
"""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from models.assembly import close_at
from models.audit import audit
from models.errors import AssemblyError, ProblemError
from models.library import is_file
from models.mechanism import Mechanism, load_mechanism
from models.names import choose, nearest
from planner.certificate import INTEGRATION_DEG
from planner.prescribed import is_whole
from planner.problem import (
    COMPILE,
    KINDS,
    OBJECTIVES,
    Limits,
    MeshSettings,
    Motion,
    PlanningProblem,
    SolverSettings,
    Tracking,
)
from planner.reference import Sine
from planner.schemes import scheme
from planner.tables import Tables, apply_override, read_tables
from planner.values import interval, number, word

KEYS: Mapping[str, tuple[str, ...]] = {
    "mechanism": ("model", "payload", "home_deg", "home_m", "independent"),
    "motion": (
        "kind",
        "start_deg",
        "start_m",
        "goal_deg",
        "goal_m",
        "start_speed_deg_s",
        "start_speed_m_s",
        "goal_speed_deg_s",
        "goal_speed_m_s",
        "duration_s",
        "max_duration_s",
    ),
    "reference": ("amplitude_deg", "amplitude_m", "bias_deg", "bias_m", "phase_deg", "frequency_hz"),
    "objective": ("minimize",),
    "limits": ("effort", "range_deg", "range_m", "speed_deg_s", "speed_m_s"),
    "mesh": ("scheme", "intervals", "effort", "tolerance_deg"),
    "solver": ("compile", "max_time_s"),
    "tracking": (
        "kp",
        "kd",
        "period_s",
        "delay_periods",
        "duration_s",
        "lqr_position_deg",
        "lqr_velocity_deg_s",
    ),
}
# The integration that judges is good to about a tenth of this.
_TIGHTEST_DEG = 1e-9
# Meshes beyond this take minutes; a typing slip of a zero should not.
MAX_INTERVALS = 20_000
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


def problem_from_tables(name: str, tables: Tables, folder: Path | None = None) -> PlanningProblem:
    """Return the problem that a file's tables mean; model paths are taken from the working folder, then the file's."""
    tables = copy.deepcopy(tables)
    _check_keys(tables)
    section = {key: tables.get(key, {}) for key in KEYS}
    mechanism = _mechanism(section["mechanism"], folder)
    tables.setdefault("mechanism", {})["model"] = section["mechanism"]["model"]
    if mechanism.n_u == 0:
        raise ProblemError(
            f"mechanism '{mechanism.name}' has no usable actuator (a motor on a hinge or slide); a plan needs one"
            + "".join(f"; {item.text}" for item in audit(mechanism.model))
        )
    kind = word(section["motion"], "motion.kind", KINDS)
    default = "tracking" if kind == "track" or (kind == "periodic" and section["reference"]) else "effort"
    objective = word(section["objective"], "objective.minimize", OBJECTIVES, default)
    reference = _reference(section["reference"], mechanism) if section["reference"] else None
    problem = PlanningProblem(
        name=name,
        mechanism=mechanism,
        motion=_motion(section["motion"], kind, mechanism, reference),
        objective=objective,
        limits=_limits(section["limits"], mechanism),
        reference=reference,
        mesh=_mesh(section["mesh"]),
        solver=_solver(section["solver"]),
        tracking=_tracking(section["tracking"]),
        source=tables,
    )
    _check_poses(section["motion"], problem)
    return problem


def mechanism_from_tables(tables: Tables, folder: Path | None = None) -> Mechanism:
    """Return the mechanism that a file's [mechanism] table means; the other tables are only checked for their keys."""
    tables = copy.deepcopy(tables)
    _check_keys(tables)
    return _mechanism(tables.get("mechanism", {}), folder)


def tracking_from_tables(tables: Tables) -> Tracking:
    """Return the tracking settings of a file's [tracking] table."""
    _check_keys(tables)
    return _tracking(tables.get("tracking", {}))


def _check_keys(tables: Tables) -> None:
    for section, content in tables.items():
        if section == "description" and isinstance(content, str):
            continue
        if section not in KEYS:
            raise ProblemError(f"unknown table or key '{section}'{nearest(section, KEYS)}; tables are {', '.join(KEYS)}")
        if not isinstance(content, dict):
            raise ProblemError(f"'{section}' is a table ([{section}]), got {content!r}")
        for key in content:
            if key not in KEYS[section]:
                raise ProblemError(
                    f"unknown key '{section}.{key}'{nearest(key, KEYS[section])}; keys are {', '.join(KEYS[section])}"
                )


def _mechanism(section: dict, folder: Path | None) -> Mechanism:
    model = section.get("model")
    if not isinstance(model, str) or not model:
        raise ProblemError(f"mechanism.model is a built-in name or a path to an MJCF file, got {model!r}")
    if folder is not None and not is_file(Path(model)) and is_file(folder / model):
        model = str(folder / model)
    if is_file(Path(model)):
        model = str(Path(model).resolve())
    section["model"] = model
    mechanism = load_mechanism(
        model, payload=section.get("payload"), home=_home(section), independent=section.get("independent")
    )
    _joint_values(section, "home", "mechanism", mechanism)  # refuses degrees for a slide and metres for a hinge
    return mechanism


def _home(section: dict) -> dict[str, float]:
    home = {}
    for key, factor in (("home_deg", np.pi / 180), ("home_m", 1.0)):
        table = section.get(key, {})
        if not isinstance(table, dict):
            raise ProblemError(f"mechanism.{key} is a table of joint = value, got {table!r}")
        for joint, value in table.items():
            home[joint] = factor * number(value, f"mechanism.{key}.{joint}")
    return home


def _joint_values(section: dict, key: str, table_name: str, mechanism: Mechanism) -> dict[int, object]:
    """Return {joint index: raw value} of `key`_deg and `key`_m (before any _s), units checked against the joints."""
    found: dict[int, object] = {}
    stem, rate = (key[: -len("_s")], "_s") if key.endswith("_s") else (key, "")
    for unit, kind, other in (("deg", "hinge", "m"), ("m", "slide", "deg")):
        name = f"{stem}_{unit}{rate}"
        table = section.get(name, {})
        if not isinstance(table, dict):
            raise ProblemError(f"{table_name}.{name} is a table of joint = value, got {table!r}")
        for joint, value in table.items():
            index = mechanism.joint_index(joint, ProblemError)
            if mechanism.joints[index].kind != kind:
                raise ProblemError(
                    f"joint '{joint}' is a {mechanism.joints[index].kind}; use {table_name}.{stem}_{other}{rate}, not {name}"
                )
            found[index] = value
    return found


def _state(section: dict, key: str, mechanism: Mechanism, default: float | None) -> np.ndarray | None:
    """Return the independent joints' values (n_s,) of a boundary condition, or None where nothing is said."""
    values = _joint_values(section, key, "motion", mechanism)
    if not values:
        return None
    result = []
    for index in mechanism.independent:
        joint = mechanism.joints[index]
        if index not in values and default is None:
            raise ProblemError(f"motion.{key}_{joint.unit} names no value for joint {joint.name}, which moves on its own")
        value = values.get(int(index), default)
        result.append(joint.read(number(value, f"motion.{key} of joint {joint.name}")))
    if key.endswith("_s"):
        for index in values:
            if index not in mechanism.independent:
                raise ProblemError(
                    f"motion.{key} of joint {mechanism.joints[index].name}: its speed follows from"
                    f" {', '.join(j.name for j in mechanism.independent_joints)}; name those"
                )
    return np.array(result)


def _motion(section: dict, kind: str, mechanism: Mechanism, reference: Sine | None) -> Motion:
    duration = section.get("duration_s", "free" if reference is None else reference.period_s)
    if isinstance(duration, str) and duration != "free":
        raise ProblemError(f'motion.duration_s is a positive number or "free", got {duration!r}')
    duration = None if duration == "free" else number(duration, "motion.duration_s", positive=True)
    longest = section.get("max_duration_s")
    repeats = kind == "periodic" and reference is not None and duration is not None
    if repeats and not is_whole(duration * reference.frequency_hz):
        raise ProblemError(
            f"motion.duration_s of a periodic motion is a whole number of the reference's periods of"
            f" {reference.period_s:g} s, got {duration:g}"
        )
    return Motion(
        kind=kind,
        start=_state(section, "start", mechanism, None),
        goal=_state(section, "goal", mechanism, None),
        start_speed=_state(section, "start_speed_s", mechanism, 0.0),
        goal_speed=_state(section, "goal_speed_s", mechanism, 0.0),
        duration_s=duration,
        max_duration_s=None if longest is None else number(longest, "motion.max_duration_s", positive=True),
    )


def _reference(section: dict, mechanism: Mechanism) -> Sine:
    def values(key: str, default: float | None) -> np.ndarray:
        found = _joint_values(section, key, "reference", mechanism)
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


def _limits(section: dict, mechanism: Mechanism) -> Limits:
    effort = np.array(mechanism.effort_limit)
    table = section.get("effort", {})
    if not isinstance(table, dict):
        raise ProblemError(f"limits.effort is a table of actuator = [low, high], got {table!r}")
    names = [actuator.name for actuator in mechanism.actuators]
    for name, value in table.items():
        effort[names.index(choose("actuator in limits.effort", name, names, ProblemError))] = interval(
            value, f"limits.effort.{name}"
        )
    position = np.array([[joint.lower, joint.upper] for joint in mechanism.joints])
    for index, value in _joint_values(section, "range", "limits", mechanism).items():
        joint = mechanism.joints[index]
        low, high = (joint.read(end) for end in interval(value, f"limits.range_{joint.unit}.{joint.name}"))
        if low < joint.lower or high > joint.upper:
            raise ProblemError(
                f"limits.range_{joint.unit}.{joint.name} = {value!r} is wider than the model's own range"
                f" [{joint.shown(joint.lower):g}, {joint.shown(joint.upper):g}], where its stops act"
            )
        position[index] = low, high
    speed = np.tile([-np.inf, np.inf], (mechanism.n_q, 1))
    for index, value in _joint_values(section, "speed_s", "limits", mechanism).items():
        joint = mechanism.joints[index]
        key = f"limits.speed_{joint.unit}_s.{joint.name}"
        if isinstance(value, list):
            ends = interval(value, key)
        else:
            ends = (-number(value, key, positive=True), number(value, key, positive=True))
        if not ends[0] <= 0 <= ends[1]:
            raise ProblemError(f"{key} admits rest, low <= 0 <= high, got {value!r}")
        speed[index] = [joint.read(end) for end in ends]
    return Limits(effort=effort, position=position, speed=speed)


def _mesh(section: dict) -> MeshSettings:
    default = MeshSettings()
    name = section.get("scheme", default.scheme)
    intervals = section.get("intervals", default.intervals)
    if not isinstance(intervals, int) or isinstance(intervals, bool) or not 2 <= intervals <= MAX_INTERVALS:
        raise ProblemError(f"mesh.intervals is a whole number from 2 to {MAX_INTERVALS}, got {intervals!r}")
    effort = section.get("effort", default.effort)
    tolerance = section.get("tolerance_deg")
    if tolerance is not None:
        tolerance = number(tolerance, "mesh.tolerance_deg", positive=True)
        if not _TIGHTEST_DEG <= tolerance <= INTEGRATION_DEG:
            raise ProblemError(
                f"mesh.tolerance_deg is from {_TIGHTEST_DEG:g} to the certificate's {INTEGRATION_DEG:g}, got {tolerance:g}"
            )
    return MeshSettings(scheme=scheme(name, effort).name, intervals=intervals, effort=effort, tolerance_deg=tolerance)


def _solver(section: dict) -> SolverSettings:
    default = SolverSettings()
    return SolverSettings(
        compile=word(section, "solver.compile", COMPILE, default.compile),
        max_time_s=number(section.get("max_time_s", default.max_time_s), "solver.max_time_s", positive=True),
    )


def _tracking(section: dict) -> Tracking:
    default = Tracking()
    delay = section.get("delay_periods", 0)
    if not isinstance(delay, int) or isinstance(delay, bool) or not 0 <= delay <= 1000:
        raise ProblemError(f"tracking.delay_periods is a whole number from 0 to 1000, got {delay!r}")
    duration = section.get("duration_s")

    def angle(key: str, value: float) -> float:
        return np.radians(number(section.get(key, np.degrees(value)), f"tracking.{key}", positive=True))

    return Tracking(
        kp=number(section.get("kp", default.kp), "tracking.kp", least=0.0),
        kd=number(section.get("kd", default.kd), "tracking.kd", least=0.0),
        period_s=number(section.get("period_s", default.period_s), "tracking.period_s", positive=True),
        delay_periods=delay,
        duration_s=None if duration is None else number(duration, "tracking.duration_s", positive=True),
        lqr_position=float(angle("lqr_position_deg", default.lqr_position)),
        lqr_velocity=float(angle("lqr_velocity_deg_s", default.lqr_velocity)),
    )


def _check_poses(section: dict, problem: PlanningProblem) -> None:
    """Refuse a start or goal whose dependent joints do not stand where the closed loop has them."""
    mechanism = problem.mechanism
    for key, s in (("start", problem.motion.start), ("goal", problem.motion.goal)):
        named = _joint_values(section, key, "motion", mechanism)
        extra = [index for index in named if index not in mechanism.independent]
        if s is None or not extra:
            continue
        try:
            pose = close_at(mechanism, s)
        except AssemblyError as error:
            raise ProblemError(f"motion.{key}_deg does not close: {error}") from error
        for index in extra:
            joint = mechanism.joints[index]
            asked = joint.read(number(named[index], f"motion.{key} of joint {joint.name}"))
            if abs(asked - pose[index]) > _POSE_TOLERANCE:
                pairs = zip(mechanism.independent_joints, s, strict=True)
                raise ProblemError(
                    f"motion.{key}_{joint.unit} does not close: with"
                    f" {', '.join(f'{j.name} = {j.shown(x):.6g}' for j, x in pairs)} the loop has {joint.name} at"
                    f" {joint.shown(pose[index]):.6g} {joint.unit}, asked {joint.shown(asked):.6g}"
                )
