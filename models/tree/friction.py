"""Dry friction of joints and tendons, smooth about rest.

Coulomb's force f against the motion, whatever its speed, jumps where the motion turns back. It is planned as

    -f tanh(v / v_0),

odd in v and within 0.5 % of f beyond 3 v_0, v_0 a speed far below those of the motion (Specker, Buchholz & Dietmayer,
Proc. IMechE K 228, 2014, compare such laws). At rest it is nothing: what holds a pose still is effort, never friction.
MuJoCo's own `frictionloss` is a soft constraint that acts in full above a speed of its own, see `gives_way_below`.
"""

import numbers
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.errors import ModelError
from linkplan.models.tree.coordinates import SLIDE, joint_label
from linkplan.models.tree.passive import disabled
from linkplan.models.tree.tendons import is_fixed, tendon_joints, tendon_label

# The speed v_0 by default [rad/s; on a slide or tendon, a second's share of the model's extent]: two degrees a second.
TRANSITION = np.radians(2.0)
# What may be asked for: below, the law is a jump to every mesh; above, friction is viscous.
_LEAST, _MOST = 1e-4, 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Rubbing:
    """One joint's degree of freedom, or a tendon, with dry friction: `force` [N.m or N], `turns` where it is a moment."""

    name: str
    force: float
    dof: int | None
    tendon: int | None
    turns: bool

    @property
    def unit(self) -> str:
        """The unit of its force."""
        return "N.m" if self.turns else "N"


def transition_speed(asked: float | None) -> float:
    """Return v_0 as asked, or by default.

    Raises:
        ModelError: for a speed that is none.
    """
    if asked is None:
        return float(TRANSITION)
    number = isinstance(asked, numbers.Real) and not isinstance(asked, bool)
    if not number or not _LEAST <= asked <= _MOST:
        raise ModelError(
            f"mechanism.friction_transition_deg_s is a speed from {np.degrees(_LEAST):g} to {np.degrees(_MOST):g} deg/s, got"
            f" {np.degrees(asked) if number else asked!r}"
        )
    return float(asked)


def friction_notes(model: mujoco.MjModel, transition: float, extent_m: float) -> list[str]:
    """Return a sentence on dry friction: how large it is, how it is planned, and where MuJoCo's own gives way."""
    found = list(rubbing_of(model))
    if not found:
        return []
    each = ", ".join(f"{one.name} {one.force:g} {one.unit}" for one in found)
    turning, sliding = (any(one.turns is turns for one in found) for turns in (True, False))
    speeds = [f"{np.degrees(transition):.3g} deg/s"] * turning + [f"{transition * extent_m:.3g} m/s"] * sliding
    text = (
        f"dry friction ({each}) is planned as f tanh(v / v_0), v_0 = {' or '.join(speeds)}: in full where things move"
        " faster, none at rest, where the effort alone holds (mechanism.friction_transition_deg_s)"
    )
    ways = [(gives_way_below(model, one), one) for one in found]
    slow, worst = max(ways, key=lambda way: way[0] / (1.0 if way[1].turns else extent_m))
    if slow > transition * (1.0 if worst.turns else extent_m):
        shown = f"{np.degrees(slow):.3g} deg/s" if worst.turns else f"{slow:.3g} m/s"
        text += (
            f"; the simulator's own gives way below {shown} ({worst.name}): solreffriction and solimpfriction of the model,"
            ' or mechanism.solref = "stiff", make it drier'
        )
    return [text]


def rubbing_of(model: mujoco.MjModel) -> Iterator[Rubbing]:
    """Yield what of a model has dry friction, unless its options switch that off."""
    off = (mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    if any(disabled(model, bit) for bit in off):
        return
    for dof in np.flatnonzero(model.dof_frictionloss > 0).tolist():
        joint = int(model.dof_jntid[dof])
        kind, place = int(model.jnt_type[joint]), dof - int(model.jnt_dofadr[joint])
        slides = kind == SLIDE or (kind == int(mujoco.mjtJoint.mjJNT_FREE) and place < 3)
        force = float(model.dof_frictionloss[dof])
        yield Rubbing(name=f"joint {joint_label(model, joint)}", force=force, dof=dof, tendon=None, turns=not slides)
    for tendon in np.flatnonzero(model.tendon_frictionloss > 0).tolist():
        joints = tendon_joints(model, tendon) if is_fixed(model, tendon) else {}
        turns = any(int(model.jnt_type[int(model.dof_jntid[dof])]) != SLIDE for dof in joints)
        force = float(model.tendon_frictionloss[tendon])
        yield Rubbing(name=f"tendon {tendon_label(model, tendon)}", force=force, dof=None, tendon=tendon, turns=turns)


def dry_friction(
    model: mujoco.MjModel,
    lengths: Sequence,
    q: ca.SX,
    qd: ca.SX,
    velocity: ca.SX,
    T: ca.SX,
    transition: float,
    extent_m: float,
) -> ca.SX:
    """Return the generalised force (n_q,) of dry friction, positive along +q.

    Args:
        model: whose friction it is.
        lengths: of its tendons, None where one has no expression.
        q: the coordinates (n_q,).
        qd: their rates.
        velocity: MuJoCo's qvel, T q'.
        T: (n_q, n_q).
        transition: v_0 [rad/s; on a slide or tendon, of the extent a second].
        extent_m: the model's size.
    """
    force, at_joints = ca.SX.zeros(model.nv), ca.SX.zeros(model.nv)
    for one in rubbing_of(model):
        slowest = transition * (1.0 if one.turns else extent_m)
        if one.dof is not None:
            at_joints[one.dof] -= one.force * ca.tanh(velocity[one.dof] / slowest)
        elif one.tendon is not None and (length := lengths[one.tendon]) is not None:
            arm = ca.jacobian(length, q)
            force -= arm.T * one.force * ca.tanh(arm @ qd / slowest)
    return force + T.T @ at_joints


def gives_way_below(model: mujoco.MjModel, one: Rubbing) -> float:
    """Return the speed [rad/s or m/s] below which MuJoCo's own dry friction is viscous and less than the model says.

    f R / b with R = A (1 - d) / d, A the row's inverse inertia at the reference pose, d the impedance of solimp and
    b = 2 / (d tc) the damping of solref (MuJoCo, Computation, "Solver parameters").
    """
    if one.dof is not None:
        inverse, solref, solimp = model.dof_invweight0[one.dof], model.dof_solref[one.dof], model.dof_solimp[one.dof]
    else:
        at = one.tendon
        inverse, solref, solimp = model.tendon_invweight0[at], model.tendon_solref_fri[at], model.tendon_solimp_fri[at]
    impedance, width = float(solimp[0]), max(float(solimp[1]), float(np.finfo(float).tiny))
    softness = float(inverse) * (1 - impedance) / impedance
    if solref[0] > 0:
        damping = 2.0 / (width * max(float(solref[0]), 2.0 * float(model.opt.timestep)))
    else:
        damping = -float(solref[1]) / width
    return float("inf") if damping <= 0 else one.force * softness / damping
