"""The closure gap of MuJoCo's soft constraints: the note of `linkplan check` on closures with a soft `solref`.

A constraint of MuJoCo opens in proportion to its force. At rest a = 0 in the row's direction, and the constraint law
a + R f = -K d r (MuJoCo, "Constraint model") gives the gap

    r = R f / (K d),

with R = A (1 - d) / d, A the inertia of the row, K from `solref` and the impedance d(r) from `solimp`. Plans have closed
loops; therefore a tracked plan differs by the gap. A coupling's gap r is in units of its first joint; the gaps here are
those of `Closure`, in metres of the joint that moves less.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.kinematics import (
    STIFF_IMPEDANCE,
    STIFF_SOLIMP,
    soft_couplings,
    stiff_time_constant_s,
    turned_coefficients,
)
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.models.reduction.reduced import acceleration_at

# A gap of more than this share of the model's extent gets a note: 0.05 mm for a model of half a metre.
NOTED_GAP_SHARE = 1e-4
# The key of a problem file, and the argument of `load_mechanism`, that makes every closure as stiff as possible.
STIFF_KEY = 'mechanism.solref = "stiff"'
# More gravity [m/s2] than on any planet: the model's lengths are in millimetres (9810) or centimetres (981).
_MOST_GRAVITY_M_S2 = 100.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SoftClosure:
    """The gap of a closure at home [m]: while the weight is held, and with one actuator at its limit.

    `stiff_gap_m` is the larger gap with `stiff_solref` and `STIFF_IMPEDANCE`, the stiffest setting for the timestep.
    `turned` is a soft coupling's attributes written the other way round, which that setting does too.
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
    model, loads, found, couplings = mechanism.model, _loads(mechanism), [], soft_couplings(mechanism.model)
    for name, index, rows, law in _closure_laws(mechanism, mechanism.home):
        forces = [(who, float(np.linalg.norm(force[rows]))) for who, force in loads]
        who, most = max(forces[1:], key=lambda item: item[1], default=(None, 0.0))
        weight, rated = (law.gap_m(force) for force in (forces[0][1], most))
        least = stiff_time_constant_s(model)
        slope = abs(float(model.eq_data[index, 1])) if index in couplings else 1.0
        # Of a coupling written the other way round, the row's unit is a_1 times as large and the force as much smaller.
        stiff = replace(
            law, scale=law.scale * slope, stiffness=1 / (STIFF_SOLIMP[1] * least) ** 2, solimp=np.array(STIFF_SOLIMP)
        )
        found.append(
            SoftClosure(
                name=name,
                solref=(float(model.eq_solref[index, 0]), float(model.eq_solref[index, 1])),
                weight_gap_m=weight,
                rated_gap_m=rated,
                rated_by=who,
                stiff_solref=f"{least:g} 1",
                stiff_gap_m=stiff.gap_m(max(forces[0][1], most)),
                turned=_turned(model, index) if index in couplings else None,
            )
        )
    soft = [one for one in found if one.gap_m > share * mechanism.extent_m]
    return tuple(sorted(soft, key=lambda one: -one.gap_m))


def _turned(model: mujoco.MjModel, index: int) -> str:
    """Return the attributes of a linear coupling written the other way round."""
    of_joints = int(model.eq_type[index]) == int(mujoco.mjtEq.mjEQ_JOINT)
    kind, named = ("joint", model.joint) if of_joints else ("tendon", model.tendon)
    first, second = (named(int(one[index])).name for one in (model.eq_obj2id, model.eq_obj1id))
    offset, slope = turned_coefficients(model, index)
    return f'{kind}1="{first}" {kind}2="{second}" polycoef="{offset + 0.0:.6g} {slope:.6g} 0 0 0"'


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ClosureLaw:
    """A constraint's law at rest: A of its rows, K, solimp, and the gap [m] of one unit of its rows."""

    inertia: float
    stiffness: float
    solimp: np.ndarray
    scale: float

    def gap_m(self, force: float) -> float:
        """Return the gap [m] under a closure force [N]."""
        return self.scale * steady_gap(self.scale * force * self.inertia, self.stiffness, self.solimp)


def held_gap(mechanism: Mechanism, pose: np.ndarray, hold: np.ndarray) -> float:
    """Return the largest closure gap [m] in MuJoCo at a pose (n_q,) held at rest by efforts (n_u,)."""
    still = np.zeros(mechanism.dof)
    force = np.array(mechanism.dynamics.closure_force(pose, still, still, hold)).ravel()
    laws = _closure_laws(mechanism, pose)
    return max((law.gap_m(float(np.linalg.norm(force[rows]))) for _, _, rows, law in laws), default=0.0)


def _closure_laws(mechanism: Mechanism, pose: np.ndarray) -> Iterator[tuple[str, int, slice, ClosureLaw]]:
    """Yield name, equality, rows of the forces and law of each active closure at a pose (n_q,)."""
    model = mechanism.model
    data = mujoco.MjData(model)
    data.qpos[:] = mechanism.qpos_of(pose)
    mujoco.mj_forward(model, data)
    equality = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    scales = {closure.index: closure.scale for closure in mechanism.closures if closure.kind in ("joint", "tendon")}
    for c, (name, index) in enumerate({closure.name: closure.index for closure in mechanism.closures}.items()):
        of_it = np.flatnonzero(equality & (np.asarray(data.efc_id) == index))
        if len(of_it):
            stiffness, _, impedance, _ = np.reshape(data.efc_KBIP, (-1, 4))[of_it[0]]
            inertia = float(data.efc_R[of_it[0]]) * impedance / (1 - impedance)
            solimp, scale = np.array(model.eq_solimp[index]), scales.get(index, 1.0)
            law = ClosureLaw(inertia=inertia, stiffness=float(stiffness), solimp=solimp, scale=scale)
            yield name, index, mechanism.closure_slice(c), law


def _loads(mechanism: Mechanism) -> list[tuple[str | None, np.ndarray]]:
    """Return the closure forces (n_rows,) at home: while the weight is held, then for each actuator alone at each limit."""
    dynamics, home, still = mechanism.dynamics, mechanism.home, np.zeros(mechanism.dof)
    hold, _ = needed_effort(mechanism, home[None], still[None], still[None])
    loads: list[tuple[str | None, np.ndarray]] = [
        (None, np.array(dynamics.closure_force(home, still, still, hold[0])).ravel())
    ]
    for j, actuator in enumerate(mechanism.actuators):
        for end in (actuator.lower, actuator.upper):
            if np.isfinite(end) and end != 0:
                effort = np.zeros(mechanism.n_u)
                effort[j] = end
                gained = acceleration_at(dynamics, home, still, effort)
                loads.append((actuator.name, np.array(dynamics.closure_force(home, still, gained, effort)).ravel()))
    return loads


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
    remedy = (
        "only a shorter timestep makes them stiffer" if stiff else f"{STIFF_KEY} makes them as stiff as the timestep admits"
    )
    means = f"{error}; plans and predictions are of closed loops; {remedy}"
    if not gap_m > NOTED_GAP_SHARE * mechanism.extent_m:
        return f"soft closures: in MuJoCo {angles}{means}" if angles else None
    share = 100 * gap_m / mechanism.extent_m
    percent = f"{share:.2g}" if share < 100 else f"{share:.0f}"  # without an exponent
    extent = 1e3 * mechanism.extent_m
    size = f"{extent:.3g}" if extent < 100 else f"{extent:.0f}"
    return (
        f"soft closures: MuJoCo's loops gape by up to {1e3 * gap_m:.3g} mm, {percent} % of the mechanism's"
        f" {size} mm{f', and {angles}' if angles else ''}{means}"
    )


def softness_error(mechanism: Mechanism, pose: np.ndarray) -> str:
    """Return the largest difference of a dependent joint in simulated poses (n, n_q) from its value with closed loops."""
    worst, closed = {"deg": (0.0, ""), "m": (0.0, "")}, mechanism.home
    for q in pose[np.unique(np.linspace(0, len(pose) - 1, num=101).astype(int))]:
        try:  # starts at the last closed pose: a pose with wide gaps is no good start
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

    The law holds for small gaps: gaps above 1 % of the extent are reported as "more than" that. A stiffer setting is
    proposed if it at least halves the gap.
    """
    soft = soft_closures(mechanism)
    if not soft:
        return None
    worst, others = soft[0], soft[1:]
    largest = 0.01 * mechanism.extent_m

    def said(gap: float) -> str:
        return f"{1e3 * gap:.2g} mm" if gap <= largest else f"more than {1e3 * largest:.2g} mm"

    also = f" (and {', '.join(one.name for one in others)})" if others else ""
    gaps = f"{said(worst.weight_gap_m)} while weight and springs are held at home"
    if worst.rated_by is not None:
        gaps += f", {said(worst.rated_gap_m)} under {worst.rated_by} at its limit"
    solref = " ".join(f"{number:g}" for number in worst.solref)
    text = f"closure {worst.name}{also} is soft (solref {solref}): the simulator's closure gap is {gaps}"
    if worst.turned is not None:
        why = f"coupling {worst.name}{also} is soft, as MuJoCo makes coefficients below 1: its gap is {gaps}"
        return f"{why}; {STIFF_KEY} or {worst.turned} closes it"
    if worst.stiff_gap_m > 0.5 * worst.gap_m:
        return f"{text}; a shorter timestep would admit a stiffer one"
    return (
        f'{text}; solref="{worst.stiff_solref}" solimp="{STIFF_IMPEDANCE}", the stiffest that its timestep admits, leaves'
        f" {said(worst.stiff_gap_m)} ({STIFF_KEY} sets it)"
    )


def massless_findings(mechanism: Mechanism) -> list[str]:
    """Return a sentence on every body with less than a millionth of the heaviest mass, in a mechanism with closures.

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
    gravity = float(np.linalg.norm(mechanism.model.opt.gravity))
    if gravity <= _MOST_GRAVITY_M_S2:
        return []
    return [
        f"gravity is {gravity:.4g} m/s2 and the moving bodies span {mechanism.extent_m:.3g} m: units are m, kg, s and N;"
        " a model in millimetres has to be converted"
    ]
