"""The serial equivalent of a linkage: its model without the loops, whose output joints carry what the linkage reflects.

The bodies of the linkage stay, welded at their home pose, so that total mass and centre of mass at home are kept; they do
not collide. Each output joint gets a motor, and the armature, damping and dry friction by which the closed chain at home
exceeds the tree. The terms that constants cannot represent are the rest, functions of the outputs' positions s and
velocities v:

    tau_closed = tau_serial(s, v, a) + dM(s) a + c(s, v) + dD(s) v + R^T f sign(R v) - F sign(v) + dg(s),

where c are the Coriolis and centrifugal terms of dM, R(s) the rates of the linkage's joints over those of the outputs, f
their dry friction, and F that of the serial model's joints: on an output that slides alone F acts at home, and less on two
that slide together. The other independent coordinates rest at home.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.errors import LinkplanError, ModelError, one_line
from linkplan.models.kinematics import data_at, fix_in_parent, path_to
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.selected_model import exact_text, whole_spec
from linkplan.models.transfer.output_map import OutputMap, output_map, transmission
from linkplan.models.transfer.polytope import effort_box
from linkplan.models.tree.coordinates import joint_label


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SerialModel:
    """A model without the loops around the output joints, as MJCF text and assembled.

    `armature`, `damping` and `friction` (n_o,) are what its output joints carry in place of the linkage. `effort_limit`
    (n_o, 2) are its motors' limits: the bounding box at home. `removed` are the joints that the linkage lost.
    """

    text: str
    outputs: OutputMap  # of the tree
    armature: np.ndarray
    damping: np.ndarray
    friction: np.ndarray
    effort_limit: np.ndarray
    removed: tuple[str, ...]
    rubbing: tuple[int, ...]  # coordinates of the closed chain that were removed and have dry friction
    rubbing_force: np.ndarray  # of each of them [N.m or N]

    @property
    def mechanism(self) -> Mechanism:
        """The tree."""
        return self.outputs.mechanism


def serial_model(outputs: OutputMap, effort_limit: np.ndarray) -> SerialModel:
    """Return the serial equivalent of a linkage.

    Args:
        outputs: the output joints and their motors, in the closed chain.
        effort_limit: of the motors (n_m, 2) [N.m or N].

    Raises:
        ModelError: if an output joint, or another driven joint, moves on a part of the linkage.
    """
    removed = _linkage_joints(outputs)
    names = [joint.name for joint in outputs.joints]
    closed = transmission(outputs, outputs.mechanism.home[None])
    box = effort_box(closed.ratio, effort_limit)[0]
    bare = _tree(outputs, removed, box)
    open_tree = _loaded(bare)
    tree = transmission(output_map(open_tree, names), open_tree.home[None])
    carried = {
        "armature": np.diagonal(closed.inertia[0] - tree.inertia[0]),
        "damping": np.diagonal(closed.damping[0] - tree.damping[0]),
        "frictionloss": closed.friction[0] - tree.friction[0],
    }
    carried = {key: np.maximum(values, 0.0) for key, values in carried.items()}
    for k, name in enumerate(names):
        joint = bare.joint(name)
        joint.armature = float(joint.armature + carried["armature"][k])
        joint.damping = [float(joint.damping[0] + carried["damping"][k]), *joint.damping[1:]]
        joint.frictionloss = float(joint.frictionloss + carried["frictionloss"][k])
    mechanism, model = _loaded(bare), outputs.mechanism.model
    dofs = [d for d in range(model.nv) if model.joint(model.dof_jntid[d]).name in removed and model.dof_frictionloss[d] > 0]
    return SerialModel(
        text=exact_text(bare),
        outputs=output_map(mechanism, names),
        armature=carried["armature"],
        damping=carried["damping"],
        friction=carried["frictionloss"],
        effort_limit=box,
        removed=tuple(removed),
        rubbing=tuple(dofs),
        rubbing_force=np.array(model.dof_frictionloss[dofs], dtype=float),
    )


def _linkage_joints(outputs: OutputMap) -> list[str]:
    """Return the joints of the model that the outputs drag along through the loops, passive ones on their bodies included.

    Raises:
        ModelError: if a joint that stays moves on one of them.
    """
    mechanism, model = outputs.mechanism, outputs.mechanism.model
    columns = list(outputs.columns)
    # The dependent coordinates that move with the outputs at some pose near home.
    random, home = np.random.default_rng(0), mechanism.home
    poses = [home, *(home + 1e-3 * random.normal(size=home.shape) for _ in range(3))]
    rates = np.max([np.abs(np.array(mechanism.dynamics.velocity_map(q)))[:, columns] for q in poses], axis=(0, 2))
    joint_of = np.array(model.dof_jntid)
    ids = {int(joint_of[i]) for i in mechanism.dependent if rates[i] > 1e-9 * rates.max()}
    bodies = {int(model.jnt_bodyid[j]) for j in ids}
    named = {int(joint_of[mechanism.independent[column]]) for column in columns}
    for dof in range(model.nv):
        joint, body = int(joint_of[dof]), int(model.dof_bodyid[dof])
        if joint in ids or bodies.isdisjoint(path_to(model, body)):
            continue
        if joint in named or dof not in mechanism.passive_dofs:
            raise ModelError(
                f"no serial equivalent: joint {joint_label(model, joint)} moves on a part of the linkage"
                f" ({model.body(body).name})"
            )
        ids.add(joint)
    return [model.joint(j).name for j in sorted(ids)]


def _tree(outputs: OutputMap, removed: list[str], box: np.ndarray) -> mujoco.MjSpec:
    """Return the model without the linkage's joints, closures and motors, and with motors on the output joints."""
    mechanism, model, spec = outputs.mechanism, outputs.mechanism.model, whole_spec(outputs.mechanism)
    data = data_at(model, mechanism.qpos_of(mechanism.home))
    bodies = {int(model.jnt_bodyid[model.joint(name).id]) for name in removed}
    for body in sorted(bodies):
        fix_in_parent(spec.bodies[body], model, data, body)
    for body in range(model.nbody):
        if not bodies.isdisjoint(path_to(model, body)):
            for geom in spec.bodies[body].geoms:
                geom.contype = geom.conaffinity = 0
    _drop(spec, mechanism, removed, [actuator.name for actuator in outputs.actuators])
    for joint, (low, high) in zip(outputs.joints, box, strict=True):
        name = joint.name if spec.actuator(joint.name) is None else f"{joint.name}_motor"
        motor = spec.add_actuator(name=name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        if np.isfinite([low, high]).all():
            motor.ctrlrange, motor.ctrllimited = [float(low), float(high)], True
    qpos = {model.joint(j).name: data.joint(j).qpos.copy() for j in range(model.njnt) if model.joint(j).name not in removed}
    spec.add_key(name="home", qpos=np.concatenate([np.atleast_1d(x) for x in qpos.values()]))
    return spec


def _drop(spec: mujoco.MjSpec, mechanism: Mechanism, removed: list[str], motors: list[str]) -> None:
    """Delete joints, the closures around them, their motors, and every element that names one of these."""
    model = mechanism.model
    J = np.array(mechanism.dynamics.closure_jacobian(mechanism.home + 1e-3))
    dofs = [d for d in range(model.nv) if model.joint(model.dof_jntid[d]).name in removed]
    touched = {one.index for one in mechanism.closures if np.any(J[one.rows][:, dofs])}
    over = [tendon for k, tendon in enumerate(spec.tendons) if _runs_over(model, k, removed)]
    tendons = {tendon.name for tendon in over if tendon.name}
    gone = {*removed, *motors, *tendons}
    for index, equality in reversed(list(enumerate(spec.equalities))):
        if index in touched or {equality.name1, equality.name2} & {*removed, *tendons}:
            spec.delete(equality)
    for sensor in list(spec.sensors):
        if sensor.objname in gone or sensor.refname in gone:
            spec.delete(sensor)
    for actuator in list(spec.actuators):
        if actuator.name in motors or actuator.target in {*removed, *tendons}:
            spec.delete(actuator)
    for tendon in over:
        spec.delete(tendon)
    for key in list(spec.keys):
        spec.delete(key)
    for name in removed:
        spec.delete(spec.joint(name))


def _runs_over(model: mujoco.MjModel, tendon: int, joints: list[str]) -> bool:
    """Return True if a fixed tendon runs over one of some joints."""
    wraps = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    over = [k for k in wraps if model.wrap_type[k] == mujoco.mjtWrap.mjWRAP_JOINT]
    return any(model.joint(int(model.wrap_objid[k])).name in joints for k in over)


def _loaded(spec: mujoco.MjSpec) -> Mechanism:
    """Return the mechanism of a specification.

    Raises:
        ModelError: if it does not compile.
    """
    try:
        spec.compile()
        return load_mechanism(exact_text(spec))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"no serial equivalent: {one_line(error)}") from error
    except LinkplanError as error:
        raise ModelError(f"no serial equivalent: {error}") from error
