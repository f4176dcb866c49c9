"""Plans on disk: `plan.json`, `trajectory.npz` and `trajectory.csv` in a folder."""

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np
from msgspec.structs import asdict

from linkplan.models.catalogue import is_file
from linkplan.models.digest import part_hashes
from linkplan.models.errors import AssemblyError, CertificateError, LinkplanError, PlanFileError
from linkplan.models.poses.contacts import Meeting
from linkplan.models.reading import shown
from linkplan.planner.certificate.certificate import Certificate, certify
from linkplan.planner.certificate.collisions import with_contacts
from linkplan.planner.certificate.saved import disagreements
from linkplan.planner.files.columns import csv_bytes, parquet_bytes
from linkplan.planner.files.folders import complete, plain_record, write_json
from linkplan.planner.files.motion_table import motion_table
from linkplan.planner.files.plan_record import FORMAT, PlanRecord, extra_records, history_of, read_plan_record
from linkplan.planner.files.problem_file import problem_from_tables
from linkplan.planner.files.tables import apply_override
from linkplan.planner.files.trajectory_file import ARRAYS, read_trajectory
from linkplan.planner.limits.path_limit import Margin
from linkplan.planner.plan import Plan, not_honoured
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit, extras_said
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.trajectory import Trajectory


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
            "extras": [asdict(one) for one in extra_records(problem.extras)],
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
    """Write a plan's files into an existing, empty folder, and read them back as `read_plan` would.

    Args:
        plan: with a motion.
        folder: where to write.
        place: where the folder will stand in the end, if not there: the model's path is kept as seen from it, too.
        jumps: whether trajectory.csv has both sides of a jump in effort, at one time.
        parquet: whether there is a trajectory.parquet beside it.

    Raises:
        PlanFileError: when the plan has no motion.
        CertificateError: when `read_plan` would refuse the files of a plan that passes.
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
    again = _judged(folder, read_plan_record(folder), read_trajectory(folder / "trajectory.npz"), plan.problem)
    if plan.passed and not again.passed:
        raise CertificateError(f"the plan is not saved, since its files could not be used: {again.message}")


def _from(place: Path, problem: PlanningProblem) -> str | None:
    """Return the path of a problem's model file as seen from a plan's folder; None for a built-in model."""
    model = problem.source.get("mechanism", {}).get("model")
    if not isinstance(model, str) or not is_file(Path(model)):
        return None
    try:
        return Path(os.path.relpath(Path(model).resolve(), place.resolve())).as_posix()
    except ValueError:  # another drive
        return None


def read_plan(
    folder: str | Path,
    overrides: Sequence[str] = (),
    *,
    anyway: bool = False,
    extra_costs: Sequence[ExtraCost] = (),
    extra_limits: Sequence[ExtraLimit] = (),
) -> Plan:
    """Return a saved plan with its solves, its problem built again and its certificate made anew from the motion on disk.

    Args:
        folder: where the plan was saved.
        overrides: "key=value" settings on the saved problem, meant for those that do not change the plan (tracking).
        anyway: whether a plan that does not pass is returned, its status "failed", and not refused.
        extra_costs: those that it was planned with. Files do not hold them: without them the objective is not checked, which
            a note of the problem says.
        extra_limits: likewise, the limits.

    Raises:
        CertificateError: when the motion on disk does not pass its certificate, or was never a plan that did.
        PlanFileError: when the folder, or a file in it, is missing, truncated or not a plan's.
    """
    folder = Path(folder)
    if folder.is_dir():
        complete(folder)
    said = read_plan_record(folder)
    trajectory = read_trajectory(folder / "trajectory.npz")
    for override in overrides:
        apply_override(said.problem, override)
    build = functools.partial(problem_from_tables, extra_costs=extra_costs, extra_limits=extra_limits)
    problem = _problem_again(said, folder, build, overrides)
    if problem.extras and extra_records(problem.extras) != said.extras:
        had = extras_said(said.extras) if said.extras else "no extra limit or cost"
        raise PlanFileError(f"'{folder}' was planned with {had}; plan.json has their bounds, weights and units; got others")
    if said.extras and not problem.extras:
        note = f"read without {_lost(said)}: nothing here was checked against it"
        problem = replace(problem, notes=(*problem.notes, note))
    plan = _judged(folder, said, trajectory, problem)
    if not plan.passed and not anyway:
        raise CertificateError(f"plan '{folder}' is not used: {plan.message}")
    return plan


def _judged(folder: Path, said: PlanRecord, trajectory: Trajectory, problem: PlanningProblem) -> Plan:
    """Return the plan that the files in a folder say of a problem, its certificate made anew: "failed" if it does not pass.

    Raises:
        PlanFileError: when the motion is of another mechanism.
    """
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
    status, message = said.status, said.message
    lost_cost = not problem.objective.extra and any(one.kind == "cost" for one in said.extras)
    misses = (*certificate.failures, *disagreements(problem, trajectory, None if lost_cost else said.objective))
    if misses:
        certificate = replace(certificate, failures=misses)
        status, message = "failed", f"failed: the motion on disk does not pass its certificate: {'; '.join(misses)}"
    return Plan(
        problem=problem,
        status=status,
        message=message,
        objective=said.objective,
        trajectory=trajectory,
        certificate=certificate,
        history=history_of(said),
        details={name: value for name, value in said.details.items() if value is not None},
    )


def _lost(said: PlanRecord) -> str:
    return f"{extras_said(said.extras)}, Python that the files do not hold"


def _problem_again(
    said: PlanRecord, folder: Path, build: Callable[..., PlanningProblem], overrides: Sequence[str] = ()
) -> PlanningProblem:
    """Return a saved plan's problem, its model from beside the plan or from where it was; refused where that has changed.

    `build` makes a problem of a name and tables.
    """
    tables = said.problem
    if isinstance(tables.get("limits"), dict):
        tables["limits"] = _unbounded(tables["limits"])
    section = tables.get("mechanism")
    models = [section.get("model")] if isinstance(section, dict) else [None]
    beside = said.model_from_here
    if beside is not None and is_file(folder / beside):
        models.insert(0, str((folder / beside).resolve()))
    guess = tables.get("guess")
    if (
        isinstance(guess, dict)
        and isinstance(guess.get("plan"), str)
        and not is_file(Path(guess["plan"]) / "trajectory.npz")
    ):
        del tables["guess"]  # where the solver once began; the motion is here without it
    refusal, changed = None, ""
    for model in dict.fromkeys(model for model in models if model is None or isinstance(model, str)):
        if isinstance(section, dict):
            section["model"] = model
        try:
            problem = build(shown(said.name), tables)
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
    why = f"{why}; it was planned with {_lost(said)}" if said.extras else why
    how = f" with {', '.join(overrides)}" if overrides else " again"
    raise PlanFileError(f"the problem in '{folder / 'plan.json'}' cannot be built{how}: {why}") from refusal


def _unbounded(value: object) -> object:
    """Return a table of limits with the infinite ends that JSON has no number for: null in [low, high]."""
    if isinstance(value, dict):
        return {key: _unbounded(item) for key, item in value.items()}
    if isinstance(value, list) and len(value) == 2 and None in value:
        return [end if item is None else item for item, end in zip(value, (-np.inf, np.inf), strict=True)]
    return [_unbounded(item) for item in value] if isinstance(value, list) else value


def _changed(said: PlanRecord, problem: PlanningProblem) -> list[str]:
    """Return the parts of a model that are not as they were planned with; nothing where that cannot be told."""
    kept = said.fingerprint
    if kept is None or said.versions.get("mujoco") != mujoco_version():
        return []
    return [part for part, digest in part_hashes(problem.mechanism.model).items() if kept.get(part, digest) != digest]


def unchecked(folder: str | Path) -> str | None:
    """Return why it cannot be told whether a saved plan's model has changed since, or None where it can."""
    said = read_plan_record(Path(folder))
    if said.fingerprint is None:
        return "plan.json has no fingerprint of its model: whether that has changed since is not known"
    then = said.versions.get("mujoco")
    if then != mujoco_version():
        return f"planned with MuJoCo {then}, this is {mujoco_version()}: whether the model has changed since is not known"
    return None


def mujoco_version() -> str:
    """Return the version of MuJoCo, which compiles the models."""
    return metadata.version("mujoco")
