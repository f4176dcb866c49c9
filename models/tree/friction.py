"""Dry friction of joints and tendons, smoothed about zero speed.

Coulomb's friction force f jumps when the velocity changes sign. The planner replaces it by

    -f tanh(v / v_0),

which is odd in v and within 0.5 % of f above 3 v_0. The transition speed v_0 is far below the speeds of the motion (Specker,
Buchholz & Dietmayer, Proc. IMechE K 228, 2014, compare such laws). The law gives no force at rest, so actuator effort alone
holds a pose. MuJoCo's own `frictionloss` is a soft constraint that is viscous at low speed, see `viscous_below`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.errors import ModelError
from linkplan.models.kinematics import disabled
from linkplan.models.symbolic_model import is_zero, number
from linkplan.models.tree.coordinates import FREE, SLIDE, joint_label
from linkplan.models.tree.tendons import is_fixed, tendon_joints, tendon_label

# Default transition speed v_0 [rad/s on a hinge; extents per second on a slide or tendon].
TRANSITION = np.radians(2.0)
# Legal range of v_0 [rad/s]. Below it no mesh resolves the law; above it the friction is viscous.
_TRANSITION_RANGE = 1e-4, 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DryFriction:
    """Dry friction of one degree of freedom or one tendon: `force` [N.m if `turns`, else N]."""

    name: str
    force: Any  # an expression where it is a parameter
    dof: int | None
    tendon: int | None
    turns: bool

    @property
    def unit(self) -> str:
        """The unit of `force`."""
        return "N.m" if self.turns else "N"


def transition_speed(asked: float | None) -> float:
    """Return the given v_0 [rad/s], or the default.

    Raises:
        ModelError: if the speed is not a number in the legal range.
    """
    if asked is None:
        return float(TRANSITION)
    least, most = _TRANSITION_RANGE
    if not least <= asked <= most:
        raise ModelError(
            f"mechanism.friction_transition_deg_s is a speed from {np.degrees(least):g} to {np.degrees(most):g} deg/s, got"
            f" {np.degrees(asked)}"
        )
    return float(asked)


def friction_notes(model: mujoco.MjModel, transition: float, extent_m: float) -> list[str]:
    """Return one note on the size of dry friction, its planned law and the speed below which MuJoCo's law is viscous."""
    found = list(frictions_of(model))
    if not found:
        return []
    each = ", ".join(f"{one.name} {one.force:g} {one.unit}" for one in found)
    turning, sliding = (any(one.turns is turns for one in found) for turns in (True, False))
    speeds = [f"{np.degrees(transition):.3g} deg/s"] * turning + [f"{transition * extent_m:.3g} m/s"] * sliding
    text = (
        f"dry friction ({each}) is planned as f tanh(v / v_0) with v_0 = {' or '.join(speeds)}: full friction at higher"
        " speeds, and none at rest, where effort alone holds a pose (mechanism.friction_transition_deg_s)"
    )
    speeds_below = [(viscous_below(model, one), one) for one in found]
    slow, worst = max(speeds_below, key=lambda pair: pair[0] / (1.0 if pair[1].turns else extent_m))
    if slow > transition * (1.0 if worst.turns else extent_m):
        shown = f"{np.degrees(slow):.3g} deg/s" if worst.turns else f"{slow:.3g} m/s"
        text += (
            f"; the simulator's own friction is viscous below {shown} ({worst.name}); solreffriction and solimpfriction of"
            ' the model, or mechanism.solref = "stiff", lower this speed'
        )
    return [text]


def frictions_of(model: mujoco.MjModel) -> Iterator[DryFriction]:
    """Yield the dry friction of a model's joints and tendons; nothing if the model's options switch friction off."""
    if disabled(model, mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT):
        return
    for dof, force in enumerate(number(model.dof_frictionloss[dof]) for dof in range(model.nv)):
        if is_zero(force):
            continue
        joint = int(model.dof_jntid[dof])
        kind, place = int(model.jnt_type[joint]), dof - int(model.jnt_dofadr[joint])
        slides = kind == SLIDE or (kind == FREE and place < 3)
        yield DryFriction(name=f"joint {joint_label(model, joint)}", force=force, dof=dof, tendon=None, turns=not slides)
    for tendon, force in enumerate(number(model.tendon_frictionloss[tendon]) for tendon in range(model.ntendon)):
        if is_zero(force):
            continue
        joints = tendon_joints(model, tendon) if is_fixed(model, tendon) else {}
        turns = any(int(model.jnt_type[int(model.dof_jntid[dof])]) != SLIDE for dof in joints)
        yield DryFriction(name=f"tendon {tendon_label(model, tendon)}", force=force, dof=None, tendon=tendon, turns=turns)


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
        model: the compiled model.
        lengths: of its tendons, None where one has no expression.
        q: the coordinates (n_q,).
        qd: their rates.
        velocity: MuJoCo's qvel, T q'.
        T: (n_q, n_q).
        transition: v_0 [rad/s on a hinge; extents per second on a slide or tendon].
        extent_m: the model's size [m].
    """
    force, at_joints = ca.SX.zeros(q.numel()), ca.SX.zeros(q.numel())
    for one in frictions_of(model):
        slowest = transition * (1.0 if one.turns else extent_m)
        if one.dof is not None:
            at_joints[one.dof] -= one.force * ca.tanh(velocity[one.dof] / slowest)
        elif one.tendon is not None and (length := lengths[one.tendon]) is not None:
            arm = ca.jacobian(length, q)
            force -= arm.T * one.force * ca.tanh(arm @ qd / slowest)
    return force + T.T @ at_joints


def viscous_below(model: mujoco.MjModel, one: DryFriction) -> float:
    """Return the speed [rad/s or m/s] below which MuJoCo's own dry friction is viscous and smaller than `frictionloss`.

    The speed is f R / b with R = A (1 - d) / d. A is the row's inverse inertia at the reference pose, d the impedance of
    solimp and b = 2 / (d tc) the damping of solref (MuJoCo, Computation, "Solver parameters").
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
