"""Plans on disk: `plan.json`, `trajectory.npz` and `trajectory.csv` in a folder."""

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np
from msgspec import structs

from linkplan.models.digest import part_hashes
from linkplan.models.errors import AssemblyError, CertificateError, LinkplanError, PlanFileError, shown
from linkplan.planner.certificate.certificate import Certificate, certify
from linkplan.planner.certificate.demands import Demand
from linkplan.planner.certificate.further_checks import disagreements, with_contacts
from linkplan.planner.files.columns import ALONG, ARRAYS, csv_bytes, parquet_bytes, read_trajectory
from linkplan.planner.files.folders import restore, write_json
from linkplan.planner.files.structs import json_values
from linkplan.planner.files.tables import apply_override
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.plan.plan import Plan, motion_table, not_honoured
from linkplan.planner.plan.record import PLAN_FORMAT, MeshRecord, PlanRecord, extra_records, read_plan_record
from linkplan.planner.plan.verdict import Verdict, failed
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit, extras_text
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


def versions() -> dict[str, str]:
    """Return the versions of linkplan and of the packages that its numbers depend on."""
    return {
        name: metadata.version(name)
        for name in ("linkplan", "mujoco", "casadi", "numpy", "scipy", "control", "python-flint")
    }


def record_of(plan: Plan) -> PlanRecord:
    """Return the record of a plan for `plan.json` and `linkplan plan --json`."""
    problem, mechanism = plan.problem, plan.problem.mechanism
    names = [actuator.name for actuator in mechanism.actuators]
    certificate = plan.certificate

    def peaks(of: str, names: Sequence[str]) -> dict | None:
        return None if certificate is None else dict(zip(names, getattr(certificate, of), strict=True))

    return PlanRecord(
        format=PLAN_FORMAT,
        name=problem.name,
        status=plan.status,
        message=plan.message,
        verdict=plan.verdict,
        objective=plan.objective,
        objective_kind=problem.objective.name,
        duration_s=plan.duration_s,
        peak_effort=peaks("peak_effort", names),
        peak_power_w=peaks("peak_power", names),
        peak_motor_power_w=peaks("peak_motor_power", names),
        peak_brake_power_w=peaks("peak_brake_power", names),
        peak_closure_force_n=peaks("peak_closure_force", mechanism.closure_names),
        effort_limit=dict(zip(names, effort_bounds(problem), strict=True)),
        effort_unit={actuator.name: actuator.unit for actuator in mechanism.actuators},
        demands=_demands(plan),
        certificate=certificate,
        proof=None if plan.proof is None else json_values(plan.proof),
        mesh=MeshRecord(scheme=plan.scheme, intervals=plan.intervals),
        time_s={
            "build": sum(step.build_s for step in plan.history),
            "solve": sum(step.solve_s for step in plan.history),
        },
        details=plan.details,
        history=plan.history,
        notes=problem.notes,
        not_honoured=not_honoured(plan),
        versions=versions(),
        fingerprint=part_hashes(mechanism.model),
        problem=problem.to_dict(),
        extras=[*extra_records(problem.extras), *problem.unread_extras],
    )


def _demands(plan: Plan) -> tuple[Demand, ...] | None:
    """Return the demands on the actuators; None without a motion, or where its loops do not close."""
    if plan.trajectory is None:
        return None
    try:
        return plan.demands()
    except AssemblyError:
        return None


def write_plan(plan: Plan, folder: Path, place: Path | None = None, *, jumps: bool = False, parquet: bool = False) -> None:
    """Write a plan's files into an existing, empty folder, and check them as `read_plan` would.

    Args:
        plan: with a motion.
        folder: where to write.
        place: the folder's final path, if it will be moved; the model's path is saved relative to it too.
        jumps: write both sides of a jump in effort to trajectory.csv, at one time.
        parquet: also write trajectory.parquet.

    Raises:
        PlanFileError: if the plan has no motion. CertificateError: if `read_plan` would refuse the files of a plan that
            passes.
    """
    if plan.trajectory is None:
        raise PlanFileError(f"nothing to save: {plan.message}")
    beside = _from(place or folder, plan.problem)
    write_json(folder / "plan.json", structs.replace(record_of(plan), model_from_here=beside))
    trajectory = plan.trajectory
    arrays = {name: of for name in (*ARRAYS, ALONG) if (of := getattr(trajectory, name)).size}
    table = motion_table(plan.problem, plan.trajectory, jumps=jumps)
    if table.site or table.body_deg:  # in addition to the motion: samples at the times of trajectory.csv
        arrays |= {"time_s": table.time_s} | {f"site_{name}_m": places for name, places in table.site.items()}
        arrays |= {f"body_{name}_deg": angles for name, angles in table.body_deg.items()}
    np.savez(folder / "trajectory.npz", periodic=np.array(trajectory.periodic), **arrays)
    (folder / "trajectory.csv").write_bytes(csv_bytes(table.columns()))
    if parquet:
        about = {"linkplan": metadata.version("linkplan"), "plan": plan.problem.name}
        (folder / "trajectory.parquet").write_bytes(parquet_bytes(table.columns(), about))
    read = read_trajectory(folder / "trajectory.npz")
    same = all(np.array_equal(getattr(read, name), getattr(trajectory, name)) for name in (*ARRAYS, ALONG))
    again = _certified(folder, read_plan_record(folder), read, plan.problem, plan.certificate if same else None)
    if plan.passed and not again.passed:
        raise CertificateError(f"the plan is not saved, because its files could not be used: {again.message}")


def _from(place: Path, problem: Problem) -> str | None:
    """Return the path of a problem's model file relative to a plan's folder; None for a built-in model."""
    model = problem.to_dict()["mechanism"]["model"]
    if not os.path.isfile(model):
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
    """Return a saved plan with its history; its problem is built again, and its motion is certified again.

    Args:
        folder: the plan's folder.
        overrides: "key=value" settings on the saved problem; they should not change the plan (tracking).
        anyway: return a plan that does not pass, with the status "failed", instead of raising.
        extra_costs: the plan's extra costs. Files do not hold them; without them the objective is not checked, and the
            problem
            gets a note.
        extra_limits: the plan's extra limits.

    Raises:
        CertificateError: when the motion on disk does not pass its certificate, or never did.
        PlanFileError: when the folder or one of its files is missing, truncated, or not a plan's.
    """
    saved, trajectory, problem = _read(Path(folder), overrides, extra_costs, extra_limits)
    plan = _certified(Path(folder), saved, trajectory, problem)
    if not plan.passed and not anyway:
        raise CertificateError(f"plan '{folder}' is not used: {plan.message}")
    return plan


def plan_without_motion(folder: Path, saved: PlanRecord) -> Plan:
    """Return the plan of a record without a motion, whose problem is built again as if it had been saved in `folder`.

    Raises:
        PlanFileError: if its problem cannot be built, or its model has changed.
    """
    verdict = saved.verdict or Verdict(kind=saved.status, words=saved.message)
    return Plan(problem=_rebuilt_problem(saved, folder, Problem.from_tables), verdict=verdict, history=saved.history)


def read_to_prove(folder: str | Path) -> Plan:
    """Return a saved plan whether or not its motion passes; its certificate is None if its loops cannot close.

    Raises:
        PlanFileError: when the folder or one of its files is missing, truncated, or not a plan's.
    """
    saved, trajectory, problem = _read(Path(folder))
    try:
        return _certified(Path(folder), saved, trajectory, problem)
    except PlanFileError as error:
        if not isinstance(error.__cause__, AssemblyError):
            raise
        return Plan(problem=problem, verdict=failed(str(error.__cause__), "certificate"), trajectory=trajectory)


def _read(
    folder: Path,
    overrides: Sequence[str] = (),
    extra_costs: Sequence[ExtraCost] = (),
    extra_limits: Sequence[ExtraLimit] = (),
) -> tuple[PlanRecord, Trajectory, Problem]:
    """Return the content of a plan's folder, and its problem, built again.

    Raises:
        PlanFileError: when the folder or one of its files is missing, truncated, or not a plan's.
    """
    restore(folder)
    saved = read_plan_record(folder)
    trajectory = read_trajectory(folder / "trajectory.npz")
    for override in overrides:
        apply_override(saved.problem, override)
    build = functools.partial(Problem.from_tables, extra_costs=extra_costs, extra_limits=extra_limits)
    problem = _rebuilt_problem(saved, folder, build, overrides)
    if problem.extras and extra_records(problem.extras) != saved.extras:
        had = extras_text(saved.extras) if saved.extras else "no extra limit or cost"
        raise PlanFileError(f"'{folder}' was planned with {had}; plan.json has their bounds, weights and units; got others")
    if saved.extras and not problem.extras:
        note = f"read without {_lost(saved)}, which was therefore not checked"
        problem = replace(problem, remarks=(note,), unread_extras=tuple(saved.extras))
    return saved, trajectory, problem


def _certified(
    folder: Path, saved: PlanRecord, trajectory: Trajectory, problem: Problem, known: Certificate | None = None
) -> Plan:
    """Return the plan in a folder's files with its known or a new certificate; its status is "failed" if it does not pass.

    Raises:
        PlanFileError: when the motion belongs to another mechanism.
    """
    mechanism = problem.mechanism
    if other := trajectory.misfit(mechanism.dof, mechanism.n_u, mechanism.n_q):
        raise PlanFileError(f"'{folder / 'trajectory.npz'}' does not fit mechanism '{mechanism.name}': {other}")
    try:
        certificate = known or with_contacts(problem, trajectory, certify(problem, trajectory))
    except AssemblyError as error:
        raise PlanFileError(
            f"'{folder / 'trajectory.npz'}' contains a motion that the mechanism cannot make: {error}"
        ) from error
    verdict = (saved.verdict or Verdict(kind=saved.status, words=saved.message)).replace(kind=saved.status)
    lost_cost = not problem.objective.extra and any(one.kind == "cost" for one in saved.extras)
    misses = (*certificate.failures, *disagreements(problem, trajectory, None if lost_cost else saved.objective))
    if misses:
        certificate = structs.replace(certificate, failures=misses)
        words = f"the motion on disk does not pass its certificate: {'; '.join(misses)}"
        verdict = failed(words, "certificate", known_by="certificate")
    return Plan(
        problem=problem,
        verdict=verdict,
        objective=None if verdict.kind == "failed" else saved.objective,
        trajectory=trajectory,
        certificate=certificate,
        history=saved.history,
        read_scheme=saved.mesh.scheme,
        details={name: value for name, value in saved.details.items() if value is not None},
    )


def _lost(saved: PlanRecord) -> str:
    return f"{extras_text(saved.extras)}, Python code that the files do not contain"


def _rebuilt_problem(
    saved: PlanRecord, folder: Path, build: Callable[..., Problem], overrides: Sequence[str] = ()
) -> Problem:
    """Return a saved plan's problem, with its model found relative to the plan or at its old path; refuse a changed model.

    `build` makes a problem from a name and tables.
    """
    tables = saved.problem
    if isinstance(tables.get("limits"), dict):
        tables["limits"] = _unbounded(tables["limits"])
    if _guess_is_lost(tables):
        del tables["guess"]  # the saved motion needs no initial guess
    section = tables.get("mechanism")
    refusal, changed = None, ""
    for model in _possible_models(saved, folder):
        if isinstance(section, dict):
            section["model"] = model
        try:
            problem = build(shown(saved.name), tables)
        except LinkplanError as error:
            refusal = refusal or error
            continue
        different = _changed(saved, problem)
        if not different:
            return problem
        changed = changed or f"model '{model}' has changed since '{folder}' was planned, in its {' and '.join(different)}"
    if changed:
        raise PlanFileError(f"{changed}; plan it again")
    why = refusal or "mechanism.model is not a name"
    why = f"{why}; it was planned with {_lost(saved)}" if saved.extras else why
    how = f" with {', '.join(overrides)}" if overrides else " again"
    raise PlanFileError(f"the problem in '{folder / 'plan.json'}' cannot be built{how}: {why}") from refusal


def _guess_is_lost(tables: dict) -> bool:
    """Check whether the initial guess was a saved plan that is no longer there."""
    guess = tables.get("guess")
    plan = guess.get("plan") if isinstance(guess, dict) else None
    return isinstance(plan, str) and not os.path.isfile(Path(plan) / "trajectory.npz")


def _possible_models(saved: PlanRecord, folder: Path) -> list[str | None]:
    """Return the names or paths under which a saved plan's model may be found, the path relative to the plan first."""
    section, relative = saved.problem.get("mechanism"), saved.model_from_here
    models: list[str | None] = [section.get("model")] if isinstance(section, dict) else [None]
    if isinstance(relative, str) and os.path.isfile(folder / relative):
        models.insert(0, str((folder / relative).resolve()))
    return list(dict.fromkeys(model for model in models if model is None or isinstance(model, str)))


def _unbounded(value: object) -> object:
    """Return a table of limits with its infinite ends, which JSON stores as null, alone or in [low, high]."""
    if isinstance(value, dict):
        return {key: np.inf if item is None else _unbounded(item) for key, item in value.items()}
    if isinstance(value, list) and len(value) == 2 and None in value:
        return [end if item is None else item for item, end in zip(value, (-np.inf, np.inf), strict=True)]
    return [_unbounded(item) for item in value] if isinstance(value, list) else value


def _changed(saved: PlanRecord, problem: Problem) -> list[str]:
    """Return the parts of a model that have changed since it was planned; empty if this is unknown."""
    kept = saved.fingerprint
    if kept is None or saved.versions.get("mujoco") != mujoco_version():
        return []
    return [part for part, digest in part_hashes(problem.mechanism.model).items() if kept.get(part, digest) != digest]


def unchecked(folder: str | Path) -> str | None:
    """Return the reason why it is unknown whether a saved plan's model has changed, or None if it is known."""
    saved = read_plan_record(Path(folder))
    if saved.fingerprint is None:
        return "plan.json has no fingerprint of its model: it is unknown whether the model has changed since"
    then = saved.versions.get("mujoco")
    if then != mujoco_version():
        return f"planned with MuJoCo {then}, this is {mujoco_version()}: it is unknown whether the model has changed since"
    return None


def mujoco_version() -> str:
    """Return the version of MuJoCo, which compiles the models."""
    return metadata.version("mujoco")
