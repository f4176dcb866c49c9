"""Published models from file to report: `python -m tests.bench.published FOLDER`, which holds `models.toml` and the models.

Each entry of `models.toml` has a `name`, a `file` in the folder and, for a part of a robot, `options`, the command line's
own (`["--keep", "left-hip-roll", "--fix-base"]`). A model goes through check, new, plan, compare and report without an
editor; the table has its freedoms beside the rank of MuJoCo's own constraint Jacobian, processor times, the tracking error,
and the distance of the plan's efforts from a projection of MuJoCo's mass matrix, bias and passive forces.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import asdict, dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from linkplan.models.errors import LinkplanError, one_line
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import equality_jacobian
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.passive import simulated_gas_springs
from linkplan.planner.plan.folder import read_plan
from linkplan.planner.plan.plan import Plan

# Processor time [s] after which a command is ended.
_MOST_TIME_S = 60
# Singular values below this share of the largest are a file's rounding.
_ROUNDING_SHARE = 1e-5


@dataclass(slots=True)
class Row:
    """A model's row: freedoms by linkplan and by MuJoCo, processor times [s] by command, errors, a verdict."""

    name: str
    freedoms: int | None = None
    freedoms_by_rank: int | None = None
    time_s: dict[str, float] = field(default_factory=dict)
    tracking_deg: float | None = None
    effort_error: float | None = None
    verdict: str = ""


def constraint_jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return MuJoCo's Jacobian (n, nv) of the active equalities at the data's pose."""
    mujoco.mj_forward(model, data)
    return equality_jacobian(model, data)


def freedoms_by_rank(mechanism: Mechanism) -> int:
    """Return nv less the rank of MuJoCo's constraint Jacobian at home, by singular values."""
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(mechanism.home)
    rows = constraint_jacobian(mechanism.model, data)
    values = np.linalg.svd(rows, compute_uv=False) if rows.size else np.zeros(1)
    return mechanism.model.nv - int(np.sum(values > _ROUNDING_SHARE * max(values.max(), 1e-300)))


def effort_error(plan: Plan, n: int = 41) -> float:
    """Return the largest distance of a plan's inverse dynamics from G^T (M q'' + h - passive), over their peak.

    The columns of G span the null space of MuJoCo's constraint Jacobian, one for each independent coordinate; q'' is a
    difference quotient of the planned speeds, away from breaks, where it jumps.
    """
    mechanism, trajectory = plan.problem.mechanism, plan.trajectory
    model, dynamics = mechanism.model, mechanism.dynamics
    data, step = mujoco.MjData(model), 1e-5 * trajectory.duration_s
    slides = model.jnt_type[model.dof_jntid] == mujoco.mjtJoint.mjJNT_SLIDE
    transition = mechanism.friction_transition * np.where(slides, mechanism.extent_m, 1.0)
    times = np.linspace(0.02, 0.98, n) * trajectory.duration_s
    times = times[np.abs(times[:, None] - trajectory.breaks_s).min(axis=1) > step]
    grid = np.sort(np.concatenate([times - step, times, times + step, [0.0]]))
    poses = follow(mechanism, trajectory.position_at(grid), trajectory.start_pose)[1:]
    speeds, accelerations = trajectory.velocity_at(grid)[1:], trajectory.acceleration_at(times)
    distance, peak = 0.0, 0.0
    for k in range(len(times)):
        around = [(poses[j], speeds[j]) for j in range(3 * k, 3 * k + 3)]
        before, v, after = (mechanism.qvel_of(q, np.array(dynamics.velocity_map(q)) @ s) for q, s in around)
        q, s = around[1]
        data.qpos[:], data.qvel[:] = mechanism.qpos_of(q), v
        basis = null_space(constraint_jacobian(model, data))
        by_joint = np.array([mechanism.rates_of(q, column)[mechanism.independent] for column in basis.T])
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        friction = model.dof_frictionloss * np.tanh(v / transition)
        springs = data.qfrc_passive + simulated_gas_springs(model, data)
        needed = mass @ ((after - before) / (2 * step)) + data.qfrc_bias - springs + friction
        projected = np.linalg.solve(by_joint, basis.T @ needed)
        own = np.array(dynamics.inverse_dynamics(q, s, accelerations[k])).ravel()
        distance, peak = max(distance, float(np.abs(projected - own).max())), max(peak, float(np.abs(own).max()))
    return distance / max(peak, 1e-300)


def null_space(rows: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (nv, n_s) of the velocities that constraint rows (n, nv) allow."""
    if not rows.size:
        return np.eye(rows.shape[1])
    _, values, right = np.linalg.svd(rows)
    return right[int(np.sum(values > _ROUNDING_SHARE * values.max())) :].T


def command(row: Row, *words: str) -> tuple[int, str]:
    """Run a command of linkplan; return its exit code and its last line, and note its processor time."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "linkplan", *words],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (_MOST_TIME_S, _MOST_TIME_S)),
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    row.time_s[words[0]] = round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1)
    lines = [line for line in (*done.stderr.splitlines(), *done.stdout.splitlines()) if line.strip()]
    verdict = next((line for line in lines if line.startswith("NOT planned")), "")
    return done.returncode, verdict or (lines[-1] if lines else "")


def tracking_error_deg(folder: Path) -> float | None:
    """Return the least largest position error [deg] among the nominal runs of a comparison's folder."""
    if not (folder / "compare.json").is_file():
        return None
    runs = json.loads((folder / "compare.json").read_text())["trackers"].values()
    return min((run["max_error_deg"] for run in runs if run.get("max_error_deg") is not None), default=None)


def go_through(entry: dict, folder: Path) -> Row:
    """Return the row of one entry of `models.toml`."""
    row, model = Row(name=entry["name"]), str(folder / entry["file"])
    options = list(entry.get("options", []))
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        command(row, "check", model, *options, "-o", str(place / "checked"))
        code, said = command(row, "new", model, *options, "-o", str(place / "first.toml"))
        row.verdict = "planned" if code == 0 else f"new: {said}"
        if (place / "first.toml").is_file():
            table = tomllib.loads((place / "first.toml").read_text())["mechanism"]
            _add_freedoms(row, table | {"model": model})
        if code == 0:
            _planned(row, place)
    return row


def _add_freedoms(row: Row, table: dict) -> None:
    from linkplan.planner.problem.build import mechanism_from_tables

    try:
        mechanism = mechanism_from_tables({"mechanism": table}) if len(table) > 1 else load_mechanism(table["model"])
    except LinkplanError as error:
        row.verdict = one_line(error)
        return
    row.freedoms, row.freedoms_by_rank = mechanism.dof, freedoms_by_rank(mechanism)


def _planned(row: Row, place: Path) -> None:
    plan = str(place / "planned")
    for words in (
        ("plan", str(place / "first.toml"), "-o", plan),
        ("compare", plan, "-o", str(place / "compared")),
        ("report", str(place / "compared"), "-o", str(place / "report.html")),
    ):
        code, said = command(row, *words)
        if code == 1 and words[0] == "compare":
            row.verdict += f"; compare: {said}"
        elif code:
            row.verdict = f"{words[0]}: {said}"
            return
    row.tracking_deg = tracking_error_deg(place / "compared")
    row.effort_error = effort_error(read_plan(plan))


def main() -> None:
    """Print a JSON object a line for each model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="of the models; default: all")
    asked = parser.parse_args()
    for entry in tomllib.loads((asked.folder / "models.toml").read_text())["model"]:
        if not asked.names or entry["name"] in asked.names:
            print(json.dumps(asdict(go_through(entry, asked.folder))), flush=True)


if __name__ == "__main__":
    main()
