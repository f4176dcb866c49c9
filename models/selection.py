"""The selection of one closed sub-chain of a robot, by dropped bodies and locked joints.

A body with locked joints is fixed in its parent, in its pose at the locked positions. Its other joints keep the axes that
they have in this pose. MuJoCo computes the second anchor of a closure between bodies at the reference pose. A lock changes
that pose, so the closure is tied to sites at the original anchors.

Another motor behind an actuator is selected by its gear and the inertia of its rotor. Its position is gear times that of the
joint, tendon or slider-crank that the actuator drives. On these its effort u is gear u, and its rotor of inertia J is
gear^2 J, which MuJoCo adds to the mass matrix (armature of the actuator).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import mujoco
import numpy as np

from linkplan.models.errors import ModelError, choose, listed
from linkplan.models.external_forces import add_forces, add_loads
from linkplan.models.foreign.deletion import delete_users, leave_the_ground
from linkplan.models.foreign.floating import floating_bodies, floating_of
from linkplan.models.foreign.rod_spins import add_universal_joints, asked_spins
from linkplan.models.foreign.urdf_loops import add_motors
from linkplan.models.ground import open_closures, stand
from linkplan.models.kinematics import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    WELD,
    data_at,
    fix_in_parent,
    in_body,
    joints_of,
    path_to,
    subtree,
    tied_bodies,
    tied_points,
)

# The keyframe at which a mechanism is assembled by default.
HOME_KEYFRAME = "home"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Selection:
    """What is taken out of a model: keys of the [mechanism] table.

    `keep`: names of bodies or joints. Their bodies are kept with everything attached to them, every chain that closes a
    loop with them, and the bodies between them and the world. All other bodies are dropped. `fix_base`: the joints between
    the world and the kept bodies are locked, and so is a base that no actuator moves. `lock`: positions by name of joints
    that are locked, in degrees on hinges and in metres on slides. `keyframe`: the name of the keyframe that gives the home
    pose and the positions of a fixed base; by default "home", else the model's reference pose. `exclude_contacts`: pairs of
    names of bodies whose geoms pass through each other. `drive`: names of joints that get a motor, within the effort limit
    of the joint. `lock_spin`: names of ball joints of rods that do not spin about their own line. `force`: constant forces
    (3,) [N] in the world's axes by the name of the site on which they act. `load`: tables of forces over a place or a
    speed. `gear`, `rotor_inertia`: of motors by actuator. `stand`: points (3,) [m] of the world on which sites by name
    stand; `open`: names of closures that are switched off. `effort_sharing`: the rule by which more actuators than freedoms
    share an effort, and `pre_tension` the efforts by actuator nearest to which they do so.
    """

    keep: Sequence[str] = ()
    fix_base: bool = False
    lock: Mapping[str, float] = field(default_factory=dict)
    keyframe: str | None = None
    exclude_contacts: Sequence[Sequence[str]] = ()
    drive: Sequence[str] = ()
    lock_spin: Sequence[str] = ()
    force: Mapping[str, Sequence[float]] = field(default_factory=dict)
    load: Sequence[Mapping[str, Any]] = ()
    gear: Mapping[str, float] = field(default_factory=dict)
    rotor_inertia: Mapping[str, float] = field(default_factory=dict)
    stand: Mapping[str, Sequence[float]] = field(default_factory=dict)
    open: Sequence[str] = ()
    effort_sharing: str | None = None
    pre_tension: Mapping[str, float] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.table())

    def table(self) -> dict[str, object]:
        """Return what is selected as keys of the [mechanism] table."""
        return {key: value for key, value in asdict(self).items() if value}


def select(spec: mujoco.MjSpec, model: mujoco.MjModel, asked: Selection) -> tuple[str, ...]:
    """Change a specification to what is selected, and return notes on what was locked and dropped.

    Args:
        spec: is changed.
        model: its compiled form.
        asked: bodies, joints and the keyframe.

    Raises:
        ModelError: for unknown names, or a joint that cannot be locked.
    """
    qpos = home_qpos(model, asked.keyframe)
    for key in list(spec.keys):
        spec.delete(key)
    chosen = [_body_of(model, name) for name in asked.keep]
    below = _closed_chain(model, chosen) if chosen else set(range(1, model.nbody))
    above = {ancestor for body in below for ancestor in path_to(model, body)} - below
    spins = asked_spins(model, asked.lock_spin)
    locked = _asked_locks(model, asked.lock) | dict.fromkeys(spins)
    floating = floating_of(model, below | above) if asked.fix_base else []
    hangs = bool({int(model.jnt_bodyid[j]) for j in floating} & set(floating_bodies(model)[0]))
    if asked.fix_base:
        joints = [j for body in sorted(above) for j in joints_of(model, body)] + floating
        locked = dict.fromkeys(joints) | locked
    dropped = [body for body in range(1, model.nbody) if body not in below | above]
    gone = [j for body in dropped for j in joints_of(model, body)]
    locked = {j: position for j, position in locked.items() if j not in gone}
    kept, away = sorted({*range(model.njnt)} - {*locked, *gone}), _joint_names(model, gone)
    notes = [*_lock(spec, model, locked, qpos, away, spins), *_drop(spec, model, dropped)]
    notes += leave_the_ground(spec) if hangs else ()
    for first, second in _filtered_pairs(model, set(locked), set(dropped)):
        spec.add_exclude(bodyname1=first, bodyname2=second)
    bodies = [body.name for body in spec.bodies]
    for pair in asked.exclude_contacts:
        first, second = (choose("body in mechanism.exclude_contacts", name, bodies) for name in pair)
        spec.add_exclude(bodyname1=first, bodyname2=second)
    if asked.exclude_contacts:
        pairs = ", ".join(f"{first} and {second}" for first, second in asked.exclude_contacts)
        notes.append(f"contacts excluded (mechanism.exclude_contacts): {pairs}")
    still = _joint_names(model, locked)  # a joint that is locked needs no motor
    notes += add_motors(spec, [name for name in asked.drive if name not in still])
    add_forces(spec, asked.force)
    notes += add_loads(spec, asked.load)
    notes += set_gearing(spec, asked.gear, asked.rotor_inertia)
    notes += open_closures(spec, asked.open)
    stand(spec, asked.stand)
    if model.nkey:
        _add_home(spec, qpos, {model.joint(j).name: _slice(model, j) for j in kept})
    return tuple(notes)


def _add_home(spec: mujoco.MjSpec, qpos: np.ndarray, places: Mapping[str, slice]) -> None:
    """Add the keyframe "home" to what is selected, from a qpos (nq,) of the whole model and its joints' places there."""
    small = spec.compile()
    home = np.array(small.qpos0)
    for j in range(small.njnt):
        if small.joint(j).name in places:  # the hinges in place of a ball joint are zero at home
            home[_slice(small, j)] = qpos[places[small.joint(j).name]]
    if not np.array_equal(home, small.qpos0):
        spec.add_key(name=HOME_KEYFRAME, qpos=home)


def home_qpos(model: mujoco.MjModel, keyframe: str | None = None) -> np.ndarray:
    """Return the qpos (nq,) of a keyframe, by default of "home"; of the reference pose where there is none."""
    names = [model.key(k).name for k in range(model.nkey)]
    if keyframe in (None, HOME_KEYFRAME):
        return np.array(model.key_qpos[names.index(HOME_KEYFRAME)] if HOME_KEYFRAME in names else model.qpos0)
    return np.array(model.key_qpos[names.index(choose("keyframe", keyframe, filter(None, names)))])


def _body_of(model: mujoco.MjModel, name: str) -> int:
    """Return the body of a name of a body or a joint.

    Raises:
        ModelError: if there is none.
    """
    bodies = {model.body(b).name: b for b in range(1, model.nbody)}
    joints = {model.joint(j).name: int(model.jnt_bodyid[j]) for j in range(model.njnt)}
    return (joints | bodies)[choose("body or joint in mechanism.keep", name, [*bodies, *joints])]


def _closed_chain(model: mujoco.MjModel, chosen: Sequence[int]) -> set[int]:
    """Return bodies with their descendants, and every chain that a closure ties to them."""
    kept = set().union(*(subtree(model, body) for body in chosen))
    pairs = [pair for i in range(model.neq) if len(pair := tied_bodies(model, i)) > 1]
    while True:
        above = {ancestor for body in kept for ancestor in path_to(model, body)[:-1]}
        tied = {body for pair in pairs if pair & kept for body in pair - kept - above - {0}}
        if not tied:
            return kept
        for body in tied:
            kept |= subtree(model, next(one for one in path_to(model, body) if one not in above))


def _asked_locks(model: mujoco.MjModel, lock: Mapping[str, float]) -> dict[int, float | None]:
    joints = {model.joint(j).name: j for j in range(model.njnt)}
    for name in lock:
        if int(model.jnt_type[joints[choose("joint in mechanism.lock", name, joints)]]) not in (HINGE, SLIDE):
            raise ModelError(
                f"mechanism.lock: joint '{name}' is a {'ball' if int(model.jnt_type[joints[name]]) == BALL else 'free'}"
                " joint, which has no single position; lock takes hinges and slides, lock_spin a rod's ball joint, and"
                " fix_base = true fixes a free base"
            )
    hinges = {name for name in lock if int(model.jnt_type[joints[name]]) == HINGE}
    return {joints[name]: float(np.radians(x)) if name in hinges else float(x) for name, x in lock.items()}


def _joint_names(model: mujoco.MjModel, joints: Iterable[int]) -> set[str]:
    return {model.joint(j).name for j in joints}


def _slice(model: mujoco.MjModel, joint: int) -> slice:
    at = int(model.jnt_qposadr[joint])
    return slice(at, at + {FREE: 7, BALL: 4}.get(int(model.jnt_type[joint]), 1))


def _lock(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    locked: Mapping[int, float | None],
    qpos: np.ndarray,
    away: set[str],
    spins: Sequence[int],
) -> list[str]:
    """Lock joints at positions, or at those of `qpos` (nq,), of `spins` the spin only; delete what acts on them.

    Returns:
        notes.
    """
    if not locked:
        return []
    _tie_to_sites(spec, model)
    said: dict[str, list[str]] = {}
    place = np.array(model.qpos0)
    for j, position in locked.items():
        place[_slice(model, j)] = qpos[_slice(model, j)] if position is None else position
    data = data_at(model, place)
    for body in sorted({int(model.jnt_bodyid[j]) for j in locked}):
        own = [j for j in joints_of(model, body) if j in locked]
        for j in own:
            kind, at = int(model.jnt_type[j]), place[_slice(model, j)][0]
            where = f"at {np.degrees(at):.6g} deg" if kind == HINGE else f"at {at:.6g} m" if kind == SLIDE else "at home"
            where = "against spin about the line of its rod" if j in spins else where
            said.setdefault(where, []).append(model.joint(j).name or f"of {model.body(body).name}")
        for j in set(range(joints_of(model, body)[0], own[-1])) - set(own):  # joints after them keep their axes
            joint = spec.joint(model.joint(j).name)
            joint.pos, joint.axis = in_body(data, body, data.xanchor[j]), data.xmat[body].reshape(3, 3).T @ data.xaxis[j]
        fix_in_parent(spec.body(model.body(body).name), model, data, body)
    add_universal_joints(spec, model, [j for j in spins if j in locked], qpos)
    gone = _joint_names(model, locked)
    scalar = [j for j in locked if int(model.jnt_type[j]) in (HINGE, SLIDE)]
    places = {model.joint(j).name: np.array([*model.qpos0[_slice(model, j)], *place[_slice(model, j)]]) for j in scalar}
    acting = delete_users(spec, gone, away, places)
    for name in gone:
        spec.delete(spec.joint(name))
    notes = ["locked: " + "; ".join(f"{listed(names, 12)} {where}" for where, names in said.items())]
    return [*notes, f"dropped with the locked joints: {', '.join(acting)}"] if acting else notes


def _tie_to_sites(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Tie the connects between bodies to sites at their compiled anchors, and write out the poses of welds."""
    for index, closure in enumerate(list(spec.equalities)):
        ends = tied_points(model, index)
        if not ends or int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE):
            continue
        if int(model.eq_type[index]) == WELD:
            closure.data = model.eq_data[index]
            continue
        name = closure.name or "-".join(model.body(end).name for end, _ in ends)
        for number, (end, point) in enumerate(ends, 1):
            body = spec.body(model.body(end).name) if end else spec.worldbody
            body.add_site(name=f"{name} anchor {number}", pos=point)
        closure.objtype = mujoco.mjtObj.mjOBJ_SITE
        closure.name, closure.name1, closure.name2 = name, f"{name} anchor 1", f"{name} anchor 2"


def _drop(spec: mujoco.MjSpec, model: mujoco.MjModel, dropped: Sequence[int]) -> list[str]:
    """Delete bodies with everything that refers to them, and return a note with their names and their mass."""
    roots = [body for body in dropped if int(model.body_parentid[body]) not in dropped]
    for body in roots:
        spec.delete(spec.body(model.body(body).name))
    if not dropped:
        return []
    mass = float(sum(model.body_mass[body] for body in dropped))
    names = listed([model.body(body).name for body in roots], 12)
    return [f"dropped with everything attached to them ({len(dropped)} bodies, {mass:.4g} kg): {names}"]


def _filtered_pairs(model: mujoco.MjModel, locked: set[int], dropped: set[int]) -> list[tuple[str, str]]:
    """Return the pairs of a fixed body and a child of it: MuJoCo filters their contacts only while both move."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        return []
    still = {0}
    for body in range(1, model.nbody):
        if int(model.body_parentid[body]) in still and locked.issuperset(joints_of(model, body)):
            still.add(body)
    solid = {int(b) for b in model.geom_bodyid[(model.geom_contype | model.geom_conaffinity) != 0]} - dropped
    weld = model.body_weldid
    return [
        (model.body(fixed).name, model.body(hanging).name)
        for fixed in sorted(solid & still)
        for hanging in sorted(solid - still)
        if weld[fixed] and weld[fixed] == weld[model.body_parentid[weld[hanging]]]
    ]


_ON_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def set_gearing(spec: mujoco.MjSpec, gear: Mapping[str, float], rotor_inertia: Mapping[str, float]) -> list[str]:
    """Give actuators by name a gear and a rotor [kg m2, or kg], and return notes on the armature of their joints.

    Raises:
        ModelError: for an unknown actuator, a gear of 0, or one that acts on anything but a hinge, slide, tendon or
            slider-crank; also for a rotor on a slider-crank.
    """
    actuators = {one.name or f"actuator {index}": one for index, one in enumerate(spec.actuators)}
    for name, ratio in gear.items():
        one = actuators[choose("actuator in mechanism.gear", name, actuators)]
        if not ratio:
            raise ModelError(f"mechanism.gear.{name} must be a number other than 0, got {ratio:g}")
        if not _has_one_ratio(spec, one) and one.trntype != mujoco.mjtTrn.mjTRN_SLIDERCRANK:
            raise ModelError(f"mechanism.gear.{name}: the actuator acts on {_target(one)}, which no single gear moves")
        one.gear = [ratio, *one.gear[1:]]
    notes = []
    for name, inertia in rotor_inertia.items():
        one = actuators[choose("actuator in mechanism.rotor_inertia", name, actuators)]
        if not _has_one_ratio(spec, one):
            raise ModelError(
                f"mechanism.rotor_inertia.{name}: the actuator acts on {_target(one)}; a rotor turns with a hinge, a slide"
                " or a tendon"
            )
        one.armature = inertia
        joint = spec.joint(one.target) if one.trntype in _ON_JOINTS else None
        if joint is not None and joint.armature:
            notes.append(
                f"joint {joint.name} has an armature of {float(joint.armature):g} in the model, which is added to the rotor"
                f" of {name}"
            )
    return notes


def _has_one_ratio(spec: mujoco.MjSpec, one: mujoco.MjsActuator) -> bool:
    """Return True if an actuator acts on a hinge, a slide or a tendon."""
    if one.trntype in _ON_JOINTS:
        return int(spec.joint(one.target).type) in (HINGE, SLIDE)
    return one.trntype == mujoco.mjtTrn.mjTRN_TENDON


def _target(one: mujoco.MjsActuator) -> str:
    return f"{one.trntype.name.removeprefix('mjTRN_').lower()} '{one.target}'"
