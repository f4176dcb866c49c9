"""Bodies that nothing holds: a robot's floating base, and loose bodies beside it."""

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from linkplan.models.errors import ModelError
from linkplan.models.kinematics import FREE, SLIDE
from linkplan.models.names import listed
from linkplan.models.ties import tied_points

# Slides of an undriven base that moves in a plane.
_PLANAR_SLIDES = 2


def subtree(model: mujoco.MjModel, body: int) -> set[int]:
    """Return a body and all that hangs on it."""
    found = {body}
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in found:
            found.add(other)
    return found


def joints_of(model: mujoco.MjModel, body: int) -> range:
    """Return the joints of a body."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def tied_bodies(model: mujoco.MjModel, index: int) -> set[int]:
    """Return the bodies that an equality constraint ties together."""
    kind, ends = int(model.eq_type[index]), (int(model.eq_obj1id[index]), int(model.eq_obj2id[index]))
    ends = tuple(end for end in ends if end >= 0)
    if kind == int(mujoco.mjtEq.mjEQ_JOINT):  # couplings have no type of object
        return {int(model.jnt_bodyid[end]) for end in ends}
    if kind == int(mujoco.mjtEq.mjEQ_TENDON):
        return set().union(*(_bodies_of_tendon(model, end) for end in ends))
    return {body for body, _ in tied_points(model, index)}


def _bodies_of_tendon(model: mujoco.MjModel, tendon: int) -> set[int]:
    found = set()
    for at in range(int(model.tendon_adr[tendon]), int(model.tendon_adr[tendon] + model.tendon_num[tendon])):
        kind, element = int(model.wrap_type[at]), int(model.wrap_objid[at])
        if kind == int(mujoco.mjtWrap.mjWRAP_JOINT):
            found.add(int(model.jnt_bodyid[element]))
        elif kind == int(mujoco.mjtWrap.mjWRAP_SITE):
            found.add(int(model.site_bodyid[element]))
        elif kind in (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER)):
            found.add(int(model.geom_bodyid[element]))
    return found


def floating_of(model: mujoco.MjModel, bodies: Iterable[int]) -> list[int]:
    """Return the joints of bodies on the world that translate in a plane or in space.

    A base that actuators drive does not float, nor does one that loops tie to the world or to what else stands on it.
    """
    driven = {int(model.actuator_trnid[a, 0]) for a in range(model.nactuator) if int(model.actuator_trntype[a]) == 0}
    found = []
    for body in bodies:
        joints = joints_of(model, body)
        kinds = [int(model.jnt_type[j]) for j in joints]
        moves = FREE in kinds or kinds.count(SLIDE) >= _PLANAR_SLIDES
        if int(model.body_parentid[body]) == 0 and moves and not driven & set(joints) and not _is_tied(model, body):
            found += list(joints)
    return found


def _is_tied(model: mujoco.MjModel, base: int) -> bool:
    """Return True if a loop connects what stands on a base with the world or with another tree of bodies."""
    pairs = [tied_bodies(model, index) for index in np.flatnonzero(model.eq_active0).tolist()]
    return any(len(pair) > 1 and sum(int(model.body_rootid[body]) == base for body in pair) == 1 for pair in pairs)


def floating_joints(model: mujoco.MjModel) -> set[int]:
    """Return the joints of bodies on the world that move freely in a plane or in space, and that nothing drives."""
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
            "take a chain with its loops out of the robot by mechanism.keep = [NAMES] and mechanism.fix_base = true; chains"
            f" begin at {', '.join(chains)}"
        )
    elif freedoms < model.nv:
        remedy = "mechanism.fix_base = true fixes what is loose where it stands"
    else:
        remedy = "nothing else moves, and a plan needs an actuator that it can use"
    whose = "its" if len(bases + loose) == 1 else "their"
    return f"{floating_words(model)}: nothing drives {whose} {freedoms} degrees of freedom; {remedy}"


def refuse_many_loose(name: str, model: mujoco.MjModel) -> None:
    """Refuse a scene with many loose bodies: each has six coordinates that nothing drives.

    Raises:
        ModelError: with the remedy.
    """
    _, loose = floating_bodies(model)
    if len(loose) > 20:  # a hand's or a table's objects; two hundred have 1,200 coordinates, which take minutes
        raise ModelError(
            f"model '{name}': {_names(model, loose)} are loose: nothing drives these {len(loose)} bodies, and a mechanism"
            " has at most 20 of them; mechanism.fix_base = true fixes them where they stand"
        )


def _names(model: mujoco.MjModel, bodies: Sequence[int]) -> str:
    """Return the names of bodies, of many the first and how many there are beside them."""
    return listed([model.body(b).name or f"body {b}" for b in bodies], 4)
