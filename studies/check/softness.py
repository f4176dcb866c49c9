"""The closure gap of MuJoCo's soft constraints: the note of `linkplan check` on closures with a soft `solref`.

A constraint of MuJoCo opens in proportion to its force. At rest a = 0 in the row's direction, and the constraint law
a + R f = -K d r (MuJoCo, "Constraint model") gives the gap

    r = R f / (K d),

with R = A (1 - d) / d, A the inertia of the row, K from `solref` and the impedance d(r) from `solimp`. Plans have closed
loops, so a tracked plan differs from the plan by the gap. MuJoCo's gap r of a coupling is in units of its first joint; the
gaps here are those of `Closure`, in metres of the joint that moves less.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import AssemblyError
from linkplan.models.kinematics import (
    STIFF_SOLIMP,
    gravity_of,
    soft_couplings,
    stiff_time_constant_s,
    turned_coefficients,
)
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import equality_rows, needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.period import travel_scales
from linkplan.models.reduction.reduced import acceleration_at
from linkplan.models.tree.joints import unit_steps
from linkplan.models.tree.passive import simulated_gas_springs
from linkplan.planner.plan.plan import Plan

# A gap of more than this share of the model's extent gets a note: 0.05 mm for a model of half a metre.
NOTED_GAP_SHARE = 1e-4
# The key of a problem file, and the argument of `load_mechanism`, that makes every closure as stiff as possible.
STIFF_KEY = 'mechanism.solref = "stiff"'
# Gravity [m/s2] above that of any planet: the model's lengths are in millimetres (9810) or centimetres (981).
_MOST_GRAVITY_M_S2 = 100.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SoftClosure:
    """The gap of a closure at home [m]: while the weight is held, and with one actuator at its limit.

    `stiff_gap_m` is the larger gap with `stiff_solref` and the stiffest impedance that the timestep permits. `turned` are
    the attributes of a soft coupling with its joints swapped; the stiff setting swaps them too.
    """

    name: str
    solref: tuple[float, float]
    weight_gap_m: float
    rated_gap_m: float
    rated_by: str | None
    stiff_solref: str
    stiff_gap_m: float
    turned: str | None

    @property
    def gap_m(self) -> float:
        """The larger gap."""
        return max(self.weight_gap_m, self.rated_gap_m)


def soft_closures(mechanism: Mechanism, share: float = NOTED_GAP_SHARE) -> tuple[SoftClosure, ...]:
    """Return the closures whose gap exceeds a share of the model's extent, in descending order."""
    model, couplings, found = mechanism.model, soft_couplings(mechanism.model), {}
    weight, *rated = _loads(mechanism)
    for k, (name, index, law) in enumerate(weight.laws):
        forces = [(load.actuator, load.forces[k]) for load in rated]
        who, most = max(forces, key=lambda item: item[1], default=(None, 0.0))
        held, pushed = (law.gap_m(force) for force in (weight.forces[k], most))
        least = stiff_time_constant_s(model)
        slope = abs(float(model.eq_data[index, 1])) if index in couplings else 1.0
        # For a coupling with swapped joints, the row's unit is a_1 times as large and the force a_1 times as small.
        stiff = replace(
            law,
            scale=law.scale * slope,
            inertia=law.inertia * slope,
            stiffness=1 / (STIFF_SOLIMP[1] * least) ** 2,
            solimp=np.array(STIFF_SOLIMP),
        )
        soft = SoftClosure(
            name=name,
            solref=(float(model.eq_solref[index, 0]), float(model.eq_solref[index, 1])),
            weight_gap_m=held,
            rated_gap_m=pushed,
            rated_by=who,
            stiff_solref=f"{least:g} 1",
            stiff_gap_m=stiff.gap_m(max(weight.forces[k], most)),
            turned=_turned(model, index) if index in couplings else None,
        )
        found[name] = max(found.get(name, soft), soft, key=lambda one: one.gap_m)
    noted = [one for one in found.values() if one.gap_m > share * mechanism.extent_m]
    return tuple(sorted(noted, key=lambda one: -one.gap_m))


def _turned(model: mujoco.MjModel, index: int) -> str:
    """Return the attributes of a linear coupling with its two joints swapped."""
    of_joints = int(model.eq_type[index]) == int(mujoco.mjtEq.mjEQ_JOINT)
    kind, named = ("joint", model.joint) if of_joints else ("tendon", model.tendon)
    first, second = (named(int(one[index])).name for one in (model.eq_obj2id, model.eq_obj1id))
    offset, slope = turned_coefficients(model, index)
    return f'{kind}1="{first}" {kind}2="{second}" polycoef="{offset + 0.0:.6g} {slope:.6g} 0 0 0"'


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ClosureLaw:
    """A constraint's law at rest: A of its rows, K, solimp, and the gap [m] per unit of its rows."""

    inertia: float
    stiffness: float
    solimp: np.ndarray
    scale: float

    def gap_m(self, force: float) -> float:
        """Return the gap [m] under a constraint force, in MuJoCo's unit of the rows."""
        return self.scale * steady_gap(force * self.inertia, self.stiffness, self.solimp)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LoadedClosures:
    """The active closures under a load: name, equality and law of each, and the magnitudes of their constraint forces.

    A weld counts as two closures: its lengths, and its angles, of which one radian counts as the mechanism's extent.
    `actuator` is the actuator that causes the load, if it is a single one.
    """

    laws: list[tuple[str, int, ClosureLaw]]
    forces: list[float]
    actuator: str | None = None

    @property
    def gap_m(self) -> float:
        """The largest gap."""
        return max((law.gap_m(force) for (_, _, law), force in zip(self.laws, self.forces, strict=True)), default=0.0)


def held_gap(mechanism: Mechanism, pose: np.ndarray, hold: np.ndarray) -> float:
    """Return the largest closure gap [m] in MuJoCo at a pose (n_q,) held at rest by efforts (n_u,)."""
    still = np.zeros(mechanism.dof)
    return loaded_closures(mechanism, pose, still, still, hold).gap_m


def loaded_closures(
    mechanism: Mechanism, pose: np.ndarray, speed: np.ndarray, acceleration: np.ndarray, effort: np.ndarray
) -> LoadedClosures:
    """Return the closures and their forces at a pose (n_q,), moving (n_s,) under efforts (n_u,)."""
    return closures_under(mechanism, pose, speed, [(acceleration, effort)])[0]


def closures_under(
    mechanism: Mechanism, pose: np.ndarray, speed: np.ndarray, loads: Sequence[tuple[np.ndarray, np.ndarray]]
) -> list[LoadedClosures]:
    """Return the closures at a pose (n_q,), moving (n_s,), under each of several accelerations (n_s,) and efforts (n_u,).

    With J the rows of the equality constraints, the forces f follow from J^T f = M q'' + h - tau. The dependent joints'
    accelerations are those at low speeds, Gamma s''.
    """
    model = mechanism.model
    if not mechanism.closures:
        return [LoadedClosures(laws=[], forces=[]) for _ in loads]
    data, gamma = mujoco.MjData(model), np.array(mechanism.dynamics.velocity_map(pose))
    data.qpos[:], data.qvel[:] = mechanism.qpos_of(pose), mechanism.qvel_of(pose, gamma @ speed)
    mujoco.mj_forward(model, data)
    rows, free = equality_rows(model, data)
    springs = data.qfrc_passive + simulated_gas_springs(model, data)
    on_joints = np.array(mechanism.dynamics.effort_matrix(pose)).reshape(mechanism.n_q, -1)
    accelerations, efforts = (np.array(values).T for values in zip(*loads, strict=True))
    units = np.array([mechanism.qvel_of(pose, unit) for unit in np.eye(mechanism.n_q)]).T  # (nv, n_q)
    driven = np.linalg.solve(units.T, on_joints @ efforts)
    pushed = rows @ free @ ((springs - data.qfrc_bias)[:, None] + driven)
    pushed -= rows @ units @ gamma @ accelerations
    forces = np.linalg.lstsq(rows @ free @ rows.T, -pushed, rcond=ROUNDING_SHARE)[0]
    parts = list(_closure_laws(mechanism, data))
    laws = [(name, index, law) for name, index, _, law in parts]
    norms = np.array([np.linalg.norm(forces[of], axis=0) for _, _, of, _ in parts]).reshape(-1, len(loads))
    return [LoadedClosures(laws=laws, forces=of_all.tolist()) for of_all in norms.T]


def _closure_laws(mechanism: Mechanism, data: mujoco.MjData) -> Iterator[tuple[str, int, np.ndarray, ClosureLaw]]:
    """Yield name, equality, rows among the equality rows, and law of each active closure; a weld's angles are separate."""
    model, owner = mechanism.model, np.array(data.efc_id[: data.ne])
    scales = {closure.index: closure.scale for closure in mechanism.closures if closure.kind in ("joint", "tendon")}
    for name, index in {closure.name: closure.index for closure in mechanism.closures}.items():
        of_it = np.flatnonzero(owner == index)
        is_weld = model.eq_type[index] == mujoco.mjtEq.mjEQ_WELD
        parts = [(of_it[:3], 1.0), (of_it[3:], mechanism.extent_m)] if is_weld else [(of_it, scales.get(index, 1.0))]
        for rows, scale in parts:
            if len(rows):
                stiffness, _, impedance, _ = np.reshape(data.efc_KBIP, (-1, 4))[rows[0]]
                inertia = float(data.efc_R[rows[0]]) * impedance / (1 - impedance)
                solimp = np.array(model.eq_solimp[index])
                yield name, index, rows, ClosureLaw(inertia=inertia, stiffness=float(stiffness), solimp=solimp, scale=scale)


def weight_load(mechanism: Mechanism) -> LoadedClosures:
    """Return the closures at home while the actuators hold the weight."""
    home, still = mechanism.home, np.zeros(mechanism.dof)
    hold, _ = needed_effort(mechanism, home[None], still[None], still[None])
    return loaded_closures(mechanism, home, still, still, hold[0])


def _loads(mechanism: Mechanism) -> list[LoadedClosures]:
    """Return the closures at home: while the weight is held, then under each actuator alone at each of its limits."""
    home, still = mechanism.home, np.zeros(mechanism.dof)
    ends = [
        (actuator.name, end * unit)
        for actuator, unit in zip(mechanism.actuators, np.eye(mechanism.n_u), strict=True)
        for end in (actuator.lower, actuator.upper)
        if np.isfinite(end) and end != 0
    ]
    gained = [(acceleration_at(mechanism.dynamics, home, still, effort), effort) for _, effort in ends]
    under = closures_under(mechanism, home, still, gained) if gained else []
    by = [replace(closures, actuator=name) for closures, (name, _) in zip(under, ends, strict=True)]
    return [weight_load(mechanism), *by]


def steady_gap(push: float, stiffness: float, solimp: np.ndarray) -> float:
    """Return the gap [m] of a constraint at rest: r = push (1 - d) / (K d^2), d = d(r).

    Args:
        push: the force times the row's inertia, an acceleration [m/s2].
        stiffness: K [1/s2].
        solimp: MuJoCo's d_0, d_width, width, midpoint and power.
    """
    low, high = 0.0, push * (1 - impedance_at(0.0, solimp)) / (stiffness * impedance_at(0.0, solimp) ** 2)
    for _ in range(60):  # bisection: the right-hand side decreases with r
        middle = (low + high) / 2
        d = impedance_at(middle, solimp)
        low, high = (middle, high) if push * (1 - d) / (stiffness * d**2) > middle else (low, middle)
    return (low + high) / 2


def impedance_at(gap: float, solimp: np.ndarray) -> float:
    """Return MuJoCo's impedance d(r) of a constraint with a gap [m] (MuJoCo, "Solver parameters", where it is clipped)."""
    d_0, d_width, midpoint = np.clip(solimp[[0, 1, 3]], mujoco.mjMINIMP, mujoco.mjMAXIMP).tolist()
    width, power = max(float(solimp[2]), mujoco.mjMINVAL), max(float(solimp[4]), 1.0)
    x = min(1.0, gap / width)
    y = x if power == 1 else x**power / midpoint ** (power - 1)
    if x > midpoint and power != 1:
        y = 1 - (1 - x) ** power / (1 - midpoint) ** (power - 1)
    return d_0 + y * (d_width - d_0)


def gap_sentence(mechanism: Mechanism, gap_m: float, gap_rad: float = 0.0, error: str = "") -> str | None:
    """Return the sentence on closure gaps of lengths [m] and angles [rad] in simulation; None if both are small.

    Small is below `NOTED_GAP_SHARE` of the extent, or of a radian. `error` is the text of `softness_error`.
    """
    angles = f"angles that closures tie are off by up to {gap_rad:.3g} rad" if gap_rad > NOTED_GAP_SHARE else ""
    stiff = "solref" in mechanism.source
    remedy = "only a shorter timestep permits more" if stiff else f"{STIFF_KEY} makes them as stiff as the timestep permits"
    means = f"{error}; plans and predictions assume closed loops; {remedy}"
    if not gap_m > NOTED_GAP_SHARE * mechanism.extent_m:
        return f"soft closures: in MuJoCo {angles}{means}" if angles else None
    share = 100 * gap_m / mechanism.extent_m
    percent = f"{share:.2g}" if share < 100 else f"{share:.0f}"  # without an exponent
    extent = 1e3 * mechanism.extent_m
    size = f"{extent:.3g}" if extent < 100 else f"{extent:.0f}"
    return (
        f"soft closures: MuJoCo's loops open by up to {1e3 * gap_m:.3g} mm, {percent} % of the mechanism's"
        f" {size} mm{f', and {angles}' if angles else ''}{means}"
    )


def softness_error(mechanism: Mechanism, pose: np.ndarray) -> str:
    """Return the largest difference of a dependent joint in simulated poses (n, n_q) from its value with closed loops."""
    worst, closed = {"deg": (0.0, ""), "m": (0.0, "")}, mechanism.home
    for q in pose[np.unique(np.linspace(0, len(pose) - 1, num=101).astype(int))]:
        try:  # starts at the last closed pose, because a pose with wide gaps is a bad initial guess
            closed = follow(mechanism, q[mechanism.independent][None], closed)[0]
        except AssemblyError:  # loops with gaps can reach positions that closed loops cannot
            continue
        for index in mechanism.dependent:
            joint = mechanism.joints[int(index)]
            worst[joint.unit] = max(worst[joint.unit], (abs(joint.shown(q[index] - closed[index])), joint.name))
    said = [f"{name} is off by up to {value:.3g} {unit}" for unit, (value, name) in worst.items() if name]
    return f", and {' and '.join(said)}" if said else ""


def softness_note(mechanism: Mechanism) -> str | None:
    """Return the sentence on a mechanism's soft closures; None if every closure gap is small.

    The law is valid for small gaps; gaps above 1 % of the extent are reported as "more than" that. A stiffer setting is
    proposed if it at least halves the gap.
    """
    soft = soft_closures(mechanism)
    if not soft:
        return None
    worst, others = soft[0], soft[1:]
    largest = 0.01 * mechanism.extent_m

    def gap_text(gap: float) -> str:
        return f"{round(1e3 * gap, 6):.2g} mm" if gap <= largest else f"more than {1e3 * largest:.2g} mm"

    also = f" (and {', '.join(one.name for one in others)})" if others else ""
    gaps = f"{gap_text(worst.weight_gap_m)} at rest at home"
    if worst.rated_by is not None:
        gaps += f" and by {gap_text(worst.rated_gap_m)} with {worst.rated_by} at its limit"
    solref = " ".join(f"{number:g}" for number in worst.solref)
    if worst.turned is not None:
        why = f"in MuJoCo coupling {worst.name}{also} opens by {gaps}, because its coefficient is below 1"
        return f"{why}; {STIFF_KEY} or {worst.turned} closes it"
    text = f"in MuJoCo loop {worst.name}{also} opens by {gaps} (solref {solref})"
    if worst.stiff_gap_m > 0.5 * worst.gap_m:
        return f"{text}; a shorter timestep would permit a stiffer loop"
    return f"{text}; {STIFF_KEY} leaves {gap_text(worst.stiff_gap_m)}"


def massless_findings(mechanism: Mechanism) -> list[str]:
    """Return a sentence on every body with less than a millionth of the largest mass, in a mechanism with closures.

    MuJoCo scales the stiffness of a closure by the inertia of its bodies. A body without mass makes the closure soft.
    """
    model, said = mechanism.model, []
    if not mechanism.closures:
        return said
    heaviest = float(model.body_mass[1:].max(initial=0.0))
    for body in range(1, model.nbody):
        with_children = float(model.body_subtreemass[body])
        if model.body_weldid[body] == body and model.body_dofnum[body] and with_children < 1e-6 * heaviest:
            said.append(
                f"body {model.body(body).name or body} has a mass of {with_children:.3g} kg where the heaviest has"
                f" {heaviest:.3g} kg: the simulator cannot hold a loop by it; give it its mass"
            )
    return said


def units_notes(mechanism: Mechanism) -> list[str]:
    """Return a note on gravity that is not in m/s2, if it is not."""
    gravity = float(np.linalg.norm(gravity_of(mechanism.model)))
    if gravity <= _MOST_GRAVITY_M_S2:
        return []
    return [
        f"gravity is {gravity:.4g} m/s2 and the moving bodies span {mechanism.extent_m:.3g} m: units are m, kg, s and N;"
        " convert a model in millimetres"
    ]


# With a larger gap the simulated mechanism differs from the planned one. At rest the gap is a share of the mechanism's
# extent or an angle [rad], in a motion a share of the travel.
SOFT_GAP = 0.01
SOFT_IN_MOTION = (
    "in simulation, the motion's efforts would open the model's loops by more than 1 % of the joints' travel: they are made"
    f" as stiff as the timestep permits ({STIFF_KEY})"
)


def home_gap(mechanism: Mechanism) -> float:
    """Return the largest closure gap in MuJoCo while the drives hold the weight at home; 0 without loops or drives.

    The gap is a share of the mechanism's extent, or an angle [rad].
    """
    if not mechanism.closures or not mechanism.n_u or not mechanism.dof:
        return 0.0
    return weight_load(mechanism).gap_m / mechanism.extent_m


def planned_gap(plan: Plan) -> float:
    """Return the largest closure gap in MuJoCo, as `home_gap` does, at instants along a plan; 0 without loops."""
    mechanism, trajectory = plan.problem.mechanism, plan.trajectory
    if not mechanism.closures:
        return 0.0
    times = 0.5 * (trajectory.breaks_s[1:] + trajectory.breaks_s[:-1])
    poses = follow(mechanism, trajectory.position_at(times), trajectory.start_pose)
    motion = trajectory.velocity_at(times), trajectory.acceleration_at(times), trajectory.effort_at(times)
    gaps = (loaded_closures(mechanism, *instant).gap_m for instant in zip(poses, *motion, strict=True))
    return max(gaps) / mechanism.extent_m


def travel(plan: Plan) -> float:
    """Return the largest travel of an independent joint along a plan: an angle [rad], or a slide's share of the extent.

    For a motor behind a gear or screw it is approximately the travel of the driven part.
    """
    mechanism, position = plan.problem.mechanism, plan.require_motion("measure").position
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m) * travel_scales(mechanism)
    return float(np.max(np.ptp(position, axis=(0, 1)) / unit, initial=0.0))
