"""Bodies that float: bases that no drive, loop or cable holds to the fixed bodies, and loose bodies."""

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from linkplan.models.errors import ModelError, counted, listed
from linkplan.models.kinematics import (
    FREE,
    SLIDE,
    actuated,
    base_of,
    bodies_of_tendon,
    data_at,
    joints_of,
    subtree,
    tied_bodies,
)

# Enough for the objects in a hand or on a table. Two hundred bodies have 1,200 coordinates and take minutes.
MAX_LOOSE_BODIES = 20


def floating_of(model: mujoco.MjModel, bodies: Iterable[int]) -> list[int]:
    """Return the joints of floating bodies.

    Their parents stand still, and they translate in a plane or in space, or fall along a rail.

    A base that actuators drive does not float, nor does one that loops or actuated cables tie to the world or to a body that
    is fixed or mounted on it. Of floating bases that are tied to one another, such as the plates of a chassis, only the
    heaviest is returned.
    """
    driven = set(actuated(model, mujoco.mjtTrn.mjTRN_JOINT))
    rotors = set(model.site_bodyid[actuated(model, mujoco.mjtTrn.mjTRN_SITE)].tolist())
    moving = set()
    for body in {base_of(model, body) for body in range(1, model.nbody)} - {0} - rotors:
        joints = joints_of(model, body)
        kinds = [int(model.jnt_type[j]) for j in joints]
        planar = kinds.count(SLIDE) >= 2
        moves = FREE in kinds or planar or any(_falls(model, j) for j in joints)
        moving |= {body} if moves and not driven & set(joints) else set()
    floating = {max(trees, key=lambda base: model.body_subtreemass[base]) for trees in _tied_trees(model) if trees <= moving}
    return [j for body in bodies if body in floating for j in joints_of(model, body)]


def _falls(model: mujoco.MjModel, joint: int) -> bool:
    """Return True if weight moves the slide of a base, and only a stop of the model can hold it."""
    if int(model.jnt_type[joint]) != SLIDE or model.jnt_stiffness[joint]:
        return False
    body, axis = int(model.jnt_bodyid[joint]), data_at(model, model.qpos0).xaxis[joint]
    weight, friction = model.body_subtreemass[body] * model.opt.gravity, model.dof_frictionloss[model.jnt_dofadr[joint]]
    ropes = [bodies_of_tendon(model, tendon) for tendon in range(model.ntendon)]
    thrusts = set(model.actuator_trntype.tolist()) - {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_TENDON)}
    ties = [tied_bodies(model, index) for index in np.flatnonzero(model.eq_active0).tolist()]
    held = model.body_gravcomp[body] or thrusts or any({body, 0} & rope for rope in ropes) or {body} in ties
    return not held and bool(abs(weight @ axis) > max(friction, 0.01 * np.linalg.norm(weight)))


def _tied_trees(model: mujoco.MjModel) -> list[set[int]]:
    """Return the bodies that stand on the world, and the world, in groups that loops or actuated cables tie together."""
    groups = [{base} for base in {base_of(model, body) for body in range(model.nbody)}]
    ties = [tied_bodies(model, index) for index in np.flatnonzero(model.eq_active0).tolist()]
    for bodies in ties + [bodies_of_tendon(model, tendon) for tendon in actuated(model, mujoco.mjtTrn.mjTRN_TENDON)]:
        ends = {base_of(model, body) for body in bodies}
        tied = [group for group in groups if group & ends]
        groups = [group for group in groups if not group & ends] + ([set().union(*tied)] if tied else [])
    return groups


def floating_joints(model: mujoco.MjModel) -> set[int]:
    """Return the joints of bases that move freely in a plane or in space, or fall, and that nothing drives."""
    return set(floating_of(model, range(1, model.nbody)))


def floating_bodies(model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Return the bodies that float: bases, on which other bodies move, and loose bodies, which carry no joint."""
    floating = list(dict.fromkeys(int(model.jnt_bodyid[j]) for j in sorted(floating_joints(model))))
    carrying = {b: model.body_dofnum[list(subtree(model, b) - {b})].any() for b in floating}
    return [b for b in floating if carrying[b]], [b for b in floating if not carrying[b]]


def floating_words(model: mujoco.MjModel) -> str:
    """Return a phrase on the bodies that float, "the base trunk floats and ball, cube are loose"; empty if none does."""
    bases, loose = floating_bodies(model)
    said = [f"the base {_names(model, bases)} floats"] if bases else []
    said += [f"{_names(model, loose)} {'are' if len(loose) > 1 else 'is'} loose"] if loose else []
    return " and ".join(said)


def floating_sentence(model: mujoco.MjModel) -> str | None:
    """Return the sentence on the bodies that float, with the remedy; None if none does."""
    bases, loose = floating_bodies(model)
    if not bases + loose:
        return None
    freedoms = int(model.body_dofnum[bases + loose].sum())
    moving = [b for b in range(1, model.nbody) if int(model.body_parentid[b]) in bases]
    chains = [model.body(b).name for b in moving if any(model.body_dofnum[below] for below in subtree(model, b))]
    if bases:
        remedy = (
            "select a chain of the robot, with its loops, by mechanism.keep = [NAMES] and mechanism.fix_base = true; chains"
            f" begin at {', '.join(chains)}"
        )
    elif freedoms < model.nv:
        remedy = "mechanism.fix_base = true fixes the loose bodies in place"
    else:
        remedy = "nothing else moves, and a plan needs an actuator that it can use"
    whose = "its" if len(bases + loose) == 1 else "their"
    return f"{floating_words(model)}: nothing drives {whose} {counted(freedoms, 'degree')} of freedom; {remedy}"


def refuse_many_loose(name: str, model: mujoco.MjModel) -> None:
    """Refuse a scene with many loose bodies: each has six coordinates that nothing drives.

    Raises:
        ModelError: with the remedy.
    """
    _, loose = floating_bodies(model)
    if len(loose) > MAX_LOOSE_BODIES:
        raise ModelError(
            f"model '{name}': {_names(model, loose)} are loose: nothing drives these {len(loose)} bodies, and a mechanism"
            f" has at most {MAX_LOOSE_BODIES} of them; mechanism.fix_base = true fixes them in place"
        )


def _names(model: mujoco.MjModel, bodies: Sequence[int]) -> str:
    """Return the names of bodies; of many, the first names and the number of the others."""
    return listed([model.body(b).name for b in bodies], 4)
