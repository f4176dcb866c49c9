"""Plans on disk: `plan.json`, `trajectory.npz` and `trajectory.csv` in a folder."""

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np

from linkplan.models.catalogue import is_file
from linkplan.models.digest import part_hashes
from linkplan.models.errors import AssemblyError, CertificateError, LinkplanError, PlanFileError
from linkplan.models.poses.contacts import Meeting
from linkplan.models.reading import read_file, shown, too_deep
from linkplan.planner.certificate.certificate import Certificate, certify
from linkplan.planner.certificate.collisions import with_contacts
from linkplan.planner.certificate.saved import disagreements
from linkplan.planner.files.columns import csv_bytes, parquet_bytes
from linkplan.planner.files.folders import complete, plain_record, write_json
from linkplan.planner.files.motion_table import motion_table
from linkplan.planner.files.problem_file import problem_from_tables
from linkplan.planner.files.saved_history import history_of
from linkplan.planner.files.tables import apply_override
from linkplan.planner.files.trajectory_file import ARRAYS, read_trajectory
from linkplan.planner.limits.path_limit import Margin
from linkplan.planner.plan import PASSED, STATUSES, Plan, not_honoured
from linkplan.planner.problem.planning_problem import PlanningProblem

FORMAT = 1
# The largest number that a float may be: files may hold longer integers.
_LARGEST = float(np.finfo(float).max)
# A plan of the largest mesh has some hundred kilobytes of words; more than this is something else.
MOST_JSON_BYTES = 64_000_000


def versions() -> dict[str, str]:
    """Return the versions of linkplan and of what its numbers depend on."""
    return {name: metadata.version(name) for name in ("linkplan", "mujoco", "casadi", "numpy", "scipy", "control")}


def record(plan: Plan) -> dict:
    """Return what `plan.json` and `linkplan plan --json` say of a plan."""
    problem, mechanism = plan.problem, plan.problem.mechanism
    names = [actuator.name for actuator in mechanism.actuators]
    certificate = plan.certificate
    return plain_record(
        {
            "format": FORMAT,
            "name": problem.name,
            "status": plan.status,
            "message": plan.message,
            "objective": plan.objective,
            "objective_kind": problem.objective.name,
            "duration_s": None if plan.trajectory is None else plan.trajectory.duration_s,
            "peak_effort": None if certificate is None else dict(zip(names, certificate.peak_effort, strict=True)),
            "peak_power_w": None if certificate is None else dict(zip(names, certificate.peak_power, strict=True)),
            "peak_closure_force_n": (
                None
                if certificate is None
                else dict(zip(mechanism.closure_names, certificate.peak_closure_force, strict=True))
            ),
            "effort_limit": dict(zip(names, problem.limits.effort, strict=True)),
            "effort_unit": {actuator.name: actuator.unit for actuator in mechanism.actuators},
            "certificate": None if certificate is None else certificate_record(problem, certificate),
            "mesh": {"scheme": plan.scheme, "intervals": plan.intervals},
            "time_s": {
                "build": sum(step.build_s for step in plan.history),
                "solve": sum(step.solve_s for step in plan.history),
            },
            "details": plan.details,
            "history": [{name: getattr(step, name) for name in step.saved()} for step in plan.history],
            "notes": list(problem.notes),
            "not_honoured": list(not_honoured(plan)),
            "versions": versions(),
            "fingerprint": part_hashes(mechanism.model),
            "problem": problem.source,
        }
    )


def certificate_record(problem: PlanningProblem, certificate: Certificate) -> dict:
    """Return a certificate's figures by name, with their units in the names."""
    joints = problem.mechanism.joints
    margins = list(zip(joints, certificate.position_margin, certificate.speed_margin, strict=True))
    return {
        "passed": certificate.passed,
        "failures": list(certificate.failures),
        "effort_excess": certificate.effort_excess,
        "inverse_dynamics_excess": certificate.inverse_dynamics_excess,
        "dynamics_residual": certificate.dynamics_residual,
        "velocity_residual": certificate.velocity_residual,
        "boundary_error": certificate.boundary_error,
        "site_error_m": certificate.site_error_m,
        **{f"closure_gap_{unit}": gap for unit, gap in ({"m": 0.0} | certificate.closure_gaps).items()},
        "integration_error_deg": certificate.integration_error_deg,
        "integration_error_m": certificate.integration_error_m,
        "integration_restarts": certificate.integration_restarts,
        "joint_margin_deg": {j.name: j.shown(m) for j, m, _ in margins if j.kind == "hinge" and np.isfinite(m)},
        "joint_margin_m": {j.name: m for j, m, _ in margins if j.kind == "slide" and np.isfinite(m)},
        "speed_margin_deg_s": {j.name: j.shown(m) for j, _, m in margins if j.kind == "hinge" and np.isfinite(m)},
        "speed_margin_m_s": {j.name: m for j, _, m in margins if j.kind == "slide" and np.isfinite(m)},
        "singularity_ratio": certificate.singularity_ratio,
        "contacts": [_contact_record(meeting) for meeting in certificate.contacts],
        "margins": [_margin_record(margin) for margin in certificate.margins],
        "worst_time_s": certificate.worst_time_s,
    }


def _margin_record(margin: Margin) -> dict:
    return {name: getattr(margin, name) for name in ("what", "name", "value", "limit", "left", "unit", "time_s")}


def _contact_record(meeting: Meeting) -> dict:
    return {
        "geoms": [meeting.first, meeting.second],
        "bodies": list(meeting.bodies),
        "since_s": meeting.since,
        "depth_m": meeting.depth_m,
        "deepest_at_s": meeting.deepest_at,
        "home_depth_m": meeting.home_depth_m,
    }


def write_plan(plan: Plan, folder: Path, place: Path | None = None, *, jumps: bool = False, parquet: bool = False) -> None:
    """Write a plan's files into an existing, empty folder.

    Args:
        plan: with a motion.
        folder: where to write.
        place: where the folder will stand in the end, if not there: the model's path is kept as seen from it, too.
        jumps: whether trajectory.csv has both sides of a jump in effort, at one time.
        parquet: whether there is a trajectory.parquet beside it.

    Raises:
        PlanFileError: when the plan has no motion.
    """
    if plan.trajectory is None:
        raise PlanFileError(f"nothing to save: {plan.message}")
    write_json(folder / "plan.json", record(plan) | {"model_from_here": _from(place or folder, plan.problem)})
    trajectory = plan.trajectory
    arrays = {name: getattr(trajectory, name) for name in ARRAYS}
    table = motion_table(plan, jumps=jumps)
    if table.site:  # beside the motion: samples, at the times of trajectory.csv
        arrays |= {"time_s": table.time_s} | {f"site_{name}_m": places for name, places in table.site.items()}
    np.savez(folder / "trajectory.npz", periodic=np.array(trajectory.periodic), **arrays)
    (folder / "trajectory.csv").write_bytes(csv_bytes(table.columns()))
    if parquet:
        about = {"linkplan": metadata.version("linkplan"), "plan": plan.problem.name}
        (folder / "trajectory.parquet").write_bytes(parquet_bytes(table.columns(), about))


def _from(place: Path, problem: PlanningProblem) -> str | None:
    """Return the path of a problem's model file as seen from a plan's folder; None for a built-in model."""
    model = problem.source.get("mechanism", {}).get("model")
    if not isinstance(model, str) or not is_file(Path(model)):
        return None
    try:
        return Path(os.path.relpath(Path(model).resolve(), place.resolve())).as_posix()
    except ValueError:  # another drive
        return None


def read_plan(folder: str | Path, overrides: Sequence[str] = (), *, anyway: bool = False) -> Plan:
    """Return a saved plan with its solves, its problem built again and its certificate made anew from the motion on disk.

    Args:
        folder: where the plan was saved.
        overrides: "key=value" settings on the saved problem, meant for those that do not change the plan (tracking).
        anyway: whether a plan that does not pass is returned, its status "failed", and not refused.

    Raises:
        CertificateError: when the motion on disk does not pass its certificate, or was never a plan that did.
        PlanFileError: when the folder, or a file in it, is missing, truncated or not a plan's.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise PlanFileError(f"'{folder}' is not a plan: a plan is a folder with plan.json and trajectory.npz")
    complete(folder)
    if not (folder / "plan.json").exists():
        within = folder / "plan"
        inside = f", as '{within}' is" if (within / "plan.json").is_file() else ""
        raise PlanFileError(
            f"'{folder}' is not a plan: it has no plan.json; a plan is a folder with that and trajectory.npz{inside}"
        )
    said = _read_json(folder / "plan.json")
    missing = [key for key in ("format", "name", "status", "message", "problem") if key not in said]
    if missing:
        raise PlanFileError(f"'{folder / 'plan.json'}' is not a plan: it lacks {', '.join(missing)}")
    if said["status"] not in STATUSES:
        raise PlanFileError(
            f"'{folder / 'plan.json'}' has status {said['status']!r}; a plan's is one of {', '.join(STATUSES)}"
        )
    details = said.get("details") or {}
    if not isinstance(details, dict):
        raise PlanFileError(f"'{folder / 'plan.json'}' has details that are no table")
    if said["format"] != FORMAT:
        raise PlanFileError(f"'{folder / 'plan.json'}' has format {said['format']!r}; this linkplan reads {FORMAT}")
    trajectory = read_trajectory(folder / "trajectory.npz")
    for override in overrides:
        apply_override(said["problem"], override)
    problem = _problem_again(said, folder, overrides)
    mechanism = problem.mechanism
    sizes = (trajectory.n_s, trajectory.velocity.shape[2], trajectory.n_u, len(trajectory.start_pose))
    if sizes != (mechanism.dof, mechanism.dof, mechanism.n_u, mechanism.n_q):
        raise PlanFileError(
            f"'{folder / 'trajectory.npz'}' is of another mechanism: it has {trajectory.n_s} independent joints and"
            f" {trajectory.n_u} actuators, '{mechanism.name}' has {mechanism.dof} and {mechanism.n_u}"
        )
    try:
        certificate = with_contacts(problem, trajectory, certify(problem, trajectory))
    except AssemblyError as error:
        raise PlanFileError(
            f"'{folder / 'trajectory.npz'}' holds a motion that the mechanism cannot make: {error}"
        ) from error
    status, message = str(said["status"]), str(said["message"])
    misses = (*certificate.failures, *disagreements(problem, trajectory, said.get("objective")))
    if misses:
        certificate = replace(certificate, failures=misses)
        status, message = "failed", f"failed: the motion on disk does not pass its certificate: {'; '.join(misses)}"
    if status not in PASSED and not anyway:
        raise CertificateError(f"plan '{folder}' is not used: {message}")
    return Plan(
        problem=problem,
        status=status,
        message=message,
        objective=_number(said.get("objective")),
        trajectory=trajectory,
        certificate=certificate,
        history=history_of(said.get("history")),
        details={str(name): value for name, told in details.items() if (value := _number(told)) is not None},
    )


def _number(value: object) -> float | None:
    """Return a figure of a record as a number; None of anything else, which an edited file may hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) <= _LARGEST else None


def _problem_again(said: dict, folder: Path, overrides: Sequence[str] = ()) -> PlanningProblem:
    """Return a saved plan's problem, its model from beside the plan or from where it was; refused where that has changed."""
    if isinstance(said["problem"].get("limits"), dict):
        said["problem"]["limits"] = _unbounded(said["problem"]["limits"])
    section = said["problem"].get("mechanism")
    models = [section.get("model")] if isinstance(section, dict) else [None]
    beside = said.get("model_from_here")
    if isinstance(beside, str) and is_file(folder / beside):
        models.insert(0, str((folder / beside).resolve()))
    guess = said["problem"].get("guess")
    if (
        isinstance(guess, dict)
        and isinstance(guess.get("plan"), str)
        and not is_file(Path(guess["plan"]) / "trajectory.npz")
    ):
        del said["problem"]["guess"]  # where the solver once began; the motion is here without it
    refusal, changed = None, ""
    for model in dict.fromkeys(model for model in models if model is None or isinstance(model, str)):
        if isinstance(section, dict):
            section["model"] = model
        try:
            problem = problem_from_tables(shown(said["name"]), said["problem"])
        except LinkplanError as error:
            refusal = refusal or error
            continue
        different = _changed(said, problem)
        if not different:
            return problem
        changed = changed or f"model '{model}' has changed since '{folder}' was planned, in its {' and '.join(different)}"
    if changed:
        raise PlanFileError(f"{changed}; plan it again")
    why = refusal or "mechanism.model is no name"
    how = f" with {', '.join(overrides)}" if overrides else " again"
    raise PlanFileError(f"the problem in '{folder / 'plan.json'}' cannot be built{how}: {why}") from refusal


def _unbounded(value: object) -> object:
    """Return a table of limits with the infinite ends that JSON has no number for: null in [low, high]."""
    if isinstance(value, dict):
        return {key: _unbounded(item) for key, item in value.items()}
    if isinstance(value, list) and len(value) == 2 and None in value:
        return [end if item is None else item for item, end in zip(value, (-np.inf, np.inf), strict=True)]
    return [_unbounded(item) for item in value] if isinstance(value, list) else value


def _changed(said: dict, problem: PlanningProblem) -> list[str]:
    """Return the parts of a model that are not as they were planned with; nothing where that cannot be told."""
    kept, versions_then = said.get("fingerprint"), said.get("versions")
    if not isinstance(kept, dict) or not isinstance(versions_then, dict) or versions_then.get("mujoco") != mujoco_version():
        return []
    return [part for part, digest in part_hashes(problem.mechanism.model).items() if kept.get(part, digest) != digest]


def unchecked(folder: str | Path) -> str | None:
    """Return why it cannot be told whether a saved plan's model has changed since, or None where it can."""
    said = _read_json(Path(folder) / "plan.json")
    if not isinstance(said.get("fingerprint"), dict):
        return "plan.json has no fingerprint of its model: whether that has changed since is not known"
    versions_then = said.get("versions")
    then = versions_then.get("mujoco") if isinstance(versions_then, dict) else None
    if then != mujoco_version():
        return f"planned with MuJoCo {then}, this is {mujoco_version()}: whether the model has changed since is not known"
    return None


def mujoco_version() -> str:
    """Return the version of MuJoCo, which compiles the models."""
    return metadata.version("mujoco")


def _read_json(path: Path) -> dict:
    try:
        said = json.loads(read_file(path, f"'{path}'", MOST_JSON_BYTES, PlanFileError).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"'{path}' is truncated or not JSON: {error}") from error
    try:
        json.dumps(said, ensure_ascii=False).encode("utf-8")
    except (ValueError, RecursionError) as error:  # halves of characters, which JSON can hold and no other file can
        raise PlanFileError(f"'{path}' holds what is no text: {str(error)[:80]}") from error
    if not isinstance(said, dict) or not isinstance(said.get("problem", {}), dict) or too_deep(said):
        raise PlanFileError(f"'{path}' is not a plan")
    return said
