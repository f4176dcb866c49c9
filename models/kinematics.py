"""The geometry of a model: places of its bodies at a pose, points that equality constraints tie, its size, its contacts."""

import mujoco
import numpy as np

from linkplan.models.errors import ModelError, nearest

# Kinds of joints, as numbers in a compiled model.
HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
BALL = int(mujoco.mjtJoint.mjJNT_BALL)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)
# The only legal value of `mechanism.solref`.
STIFF = "stiff"
# The impedance of the built-in models, close to MuJoCo's maximum of 0.9999 (MuJoCo, "Solver parameters": d_0, d_width,
# width [m], midpoint, power).
STIFF_SOLIMP = (0.999, 0.999, 0.001, 0.5, 2.0)
CONNECT, WELD = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)


def disabled(model: mujoco.MjModel, *bits: mujoco.mjtDisableBit) -> bool:
    """Return True if any of these disable flags of the model's options is set."""
    return any(model.opt.disableflags & int(bit) for bit in bits)


def gravity_of(model: mujoco.MjModel) -> np.ndarray:
    """Return a model's gravity (3,) [m/s2]; zero if it is disabled."""
    return np.zeros(3) if disabled(model, mujoco.mjtDisableBit.mjDSBL_GRAVITY) else np.array(model.opt.gravity)


def may_collide(model: mujoco.MjModel) -> bool:
    """Return True if any two geoms of a model can be in contact."""
    if disabled(model, mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT):
        return False
    return bool(model.npair) or bool(np.any(model.geom_contype) and np.any(model.geom_conaffinity))


def data_at(model: mujoco.MjModel, qpos: np.ndarray | None = None) -> mujoco.MjData:
    """Return MuJoCo's data with the kinematics at a qpos (nq,), by default at the model's reference pose."""
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def fields_at(model: mujoco.MjModel, qpos: np.ndarray, *fields: str) -> list[np.ndarray]:
    """Return fields of MuJoCo's kinematics, such as "xanchor" (njnt, 3) [m], at qpos (n, nq), each (n, ...)."""
    data = mujoco.MjData(model)
    found = [np.empty((len(qpos), *getattr(data, field).shape)) for field in fields]
    for k, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        for array, field in zip(found, fields, strict=True):
            array[k] = getattr(data, field)
    return found


def in_world(data: mujoco.MjData, body: int, place: np.ndarray) -> np.ndarray:
    """Return the world position (3,) [m] of a point in a body's frame."""
    return data.xpos[body] + data.xmat[body].reshape(3, 3) @ place


def in_body(data: mujoco.MjData, body: int, place: np.ndarray) -> np.ndarray:
    """Return the position (3,) [m] in a body's frame of a point in the world."""
    return data.xmat[body].reshape(3, 3).T @ (place - data.xpos[body])


def rotation_of_rpy(rpy: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) of roll, pitch and yaw [rad], about fixed axes."""
    quaternion, turn = np.zeros(4), np.zeros(9)
    mujoco.mju_euler2Quat(quaternion, rpy, "XYZ")
    mujoco.mju_quat2Mat(turn, quaternion)
    return turn.reshape(3, 3)


def fix_in_parent(part: "mujoco._specs.MjsBody", model: mujoco.MjModel, data: mujoco.MjData, body: int) -> None:
    """Set the pose in its parent of a specification's body, which is `body` of the model, to that of `data`."""
    parent = int(model.body_parentid[body])
    inverse, turn = np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(inverse, data.xquat[parent])
    mujoco.mju_mulQuat(turn, inverse, data.xquat[body])
    if part.frame is not None:
        part.set_frame(part.parent.add_frame())
    part.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    part.pos, part.quat = in_body(data, parent, data.xpos[body]), turn


def stiff_time_constant_s(model: mujoco.MjModel) -> float:
    """Return the least time constant [s] that MuJoCo admits for constraints, two timesteps."""
    return 2.0 * float(model.opt.timestep)


def set_softness(model: mujoco.MjModel, asked: object) -> None:
    """Set the stiffest equality constraints and dry friction if `asked` is "stiff"; keep the model's own if it is None.

    Linear couplings of joints or tendons with a slope below one are written the other way round, see `soft_couplings`.

    Raises:
        ModelError: if `asked` has another value.
    """
    if asked is None:
        return
    if asked != STIFF:
        raise ModelError(
            f'mechanism.solref is "{STIFF}", the stiffest closures that the timestep admits, or is left out, which keeps the'
            f" model's own; got {asked!r}{nearest(str(asked), [STIFF])}"
        )
    model.eq_solref[:] = stiff_time_constant_s(model), 1.0
    model.eq_solimp[:] = np.array(STIFF_SOLIMP)
    for index in soft_couplings(model):
        model.eq_data[index, :2] = turned_coefficients(model, index)
        model.eq_obj1id[index], model.eq_obj2id[index] = int(model.eq_obj2id[index]), int(model.eq_obj1id[index])
    make_dry(model, model.dof_frictionloss > 0)
    dry = model.tendon_frictionloss > 0
    model.tendon_solref_fri[dry] = stiff_time_constant_s(model), 1.0
    model.tendon_solimp_fri[dry] = np.array(STIFF_SOLIMP)


def soft_couplings(model: mujoco.MjModel) -> list[int]:
    """Return the equality constraints y = a_0 + a_1 x of joints or tendons with |a_1| < 1: they are soft for a small slope.

    MuJoCo estimates the inertia of such a row without its coefficients, as 1/m_y + 1/m_x where a_1^2/m_x would be right, and
    makes it softer by 1/a_1^2 than x = (y - a_0) / a_1, which is the same coupling (`mj_makeImpedance`, `mj_diagApprox`).
    """
    coupled = np.isin(model.eq_type, [int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)]) & (model.eq_obj2id >= 0)
    linear = ~np.any(model.eq_data[:, 2:5], axis=1)
    slope = np.abs(model.eq_data[:, 1])
    return np.flatnonzero(coupled & linear & (slope > 0) & (slope < 1)).tolist()


def turned_coefficients(model: mujoco.MjModel, index: int) -> tuple[float, float]:
    """Return the coefficients of a linear coupling y = a_0 + a_1 x written as x = b_0 + b_1 y."""
    offset, slope = (float(a) for a in model.eq_data[index, :2])
    return -offset / slope, 1.0 / slope


def make_dry(model: mujoco.MjModel, dofs: np.ndarray) -> None:
    """Set the stiffest dry friction for the degrees of freedom in the mask `dofs` (nv,).

    MuJoCo's dry friction is viscous below a speed (`models.tree.friction.viscous_below`). With MuJoCo's defaults this speed
    is 9 rad/s for 0.4 N.m at the knee's coupler, whose inertia is small: the joint would creep where it should stick.
    """
    model.dof_solref[dofs] = stiff_time_constant_s(model), 1.0
    model.dof_solimp[dofs] = np.array(STIFF_SOLIMP)


def tied_points(model: mujoco.MjModel, index: int) -> list[tuple[int, np.ndarray]]:
    """Return the two points that a connect or weld ties, each as a body and a position (3,) [m] in that body's frame.

    The positions are views of the model's arrays. The list is empty for an equality constraint of another kind.
    """
    kind = int(model.eq_type[index])
    if kind not in (CONNECT, WELD):
        return []
    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE):
        return [(int(model.site_bodyid[site]), model.site_pos[site]) for site in (first, second)]
    points = [model.eq_data[index, 0:3], model.eq_data[index, 3:6]]
    if kind == WELD:  # MuJoCo stores the second body's point first
        points.reverse()
    return [(first, points[0]), (second, points[1])]


def subtree(model: mujoco.MjModel, body: int) -> set[int]:
    """Return a body and its descendants."""
    found = {body}
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in found:
            found.add(other)
    return found


def path_to(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the bodies from the world's child on to a body, which is the last; none for the world."""
    path = []
    while body:
        path.insert(0, body)
        body = int(model.body_parentid[body])
    return path


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
        return set().union(*(bodies_of_tendon(model, end) for end in ends))
    return {body for body, _ in tied_points(model, index)}


def base_of(model: mujoco.MjModel, body: int) -> int:
    """Return the outermost moving body that carries a body; the world, 0, for one that stands still."""
    if not model.body_weldid[body]:
        return 0
    while model.body_weldid[parent := int(model.body_parentid[body])]:
        body = parent
    return body


def actuated(model: mujoco.MjModel, transmission: mujoco.mjtTrn) -> list[int]:
    """Return the joints, sites or tendons that actuators with a gain act on."""
    commanded = (model.actuator_gaintype != int(mujoco.mjtGain.mjGAIN_FIXED)) | (model.actuator_gainprm[:, 0] != 0)
    return model.actuator_trnid[(model.actuator_trntype == transmission) & commanded, 0].tolist()


def bodies_of_tendon(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Return the bodies that a tendon's joints move, and those that it runs along."""
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


def rod_line(model: mujoco.MjModel, joint: int) -> np.ndarray | None:
    """Return the line (3,) about which a rod on a ball joint may spin, in its own frame, or None if the body is not a rod.

    A body is a rod if its connects and the ball joints of the bodies that it carries lie on one line through its joint.
    """
    points = _held_at(model, joint)
    if points is None:
        return None
    lines = [_unit(point - model.jnt_pos[joint]) for point in points]
    return lines[0] if lines and _in_line(lines) else None


def spin_line(model: mujoco.MjModel, joint: int) -> np.ndarray | None:
    """Return the line (3,) about which a body on a ball or free joint may spin, in its own frame, or None.

    For a rod it is the line of `rod_line`. For a floating body, or a body on a rod, it passes through the body's connects.
    """
    if int(model.jnt_type[joint]) == BALL and (line := rod_line(model, joint)) is not None:
        return line
    carried = int(model.jnt_type[joint]) == BALL and _rod_before(model, joint) is not None
    points = _held_at(model, joint) if carried or int(model.jnt_type[joint]) == FREE else None
    if not points:
        return None
    lines = [line for point in points[1:] if (line := _unit(point - points[0])) is not None]
    return lines[0] if lines and _in_line(lines) else None


def carrying_axis(model: mujoco.MjModel, joint: int, reference: np.ndarray) -> np.ndarray | None:
    """Return the axis (3,) about which a body's carrier turns, in the body's frame at `reference` (nq,), or None.

    It is the hinge axis, or the rod's line, of the parent. For a floating body it is the hinge axis of a body tied to it.
    """
    body = int(model.jnt_bodyid[joint])
    before = [int(model.body_weldid[model.body_parentid[body]])]
    if int(model.jnt_type[joint]) == FREE:
        ties = [[int(model.body_weldid[tied]) for tied, _ in tied_points(model, index)] for index in range(model.neq)]
        before = [other for pair in ties if body in pair for other in pair if other != body]
    data = data_at(model, reference)
    frame = data.xmat[body].reshape(3, 3)
    for carrier in before:
        for hinge in reversed(joints_of(model, carrier)):
            if int(model.jnt_type[hinge]) == HINGE:
                return frame.T @ data.xaxis[hinge]
    line = _rod_before(model, joint)
    return None if line is None else frame.T @ data.xmat[before[0]].reshape(3, 3) @ line


def _rod_before(model: mujoco.MjModel, joint: int) -> np.ndarray | None:
    """Return the line (3,) of the rod that carries a joint's body, in the rod's frame, or None if the carrier is no rod."""
    carrier = int(model.body_weldid[model.body_parentid[model.jnt_bodyid[joint]]])
    first = int(model.body_jntadr[carrier])
    return rod_line(model, first) if first >= 0 and int(model.jnt_type[first]) == BALL else None


def _held_at(model: mujoco.MjModel, joint: int) -> list[np.ndarray] | None:
    """Return the points (3,) [m], in the body's frame, of the connects and carried ball joints of a joint's body.

    None if anything else constrains the body, or if it has a second joint.
    """
    body, points = int(model.jnt_bodyid[joint]), []
    if int(model.body_jntnum[body]) != 1:
        return None
    for child in np.flatnonzero(model.body_parentid == body).tolist():
        first = int(model.body_jntadr[child])
        if int(model.body_jntnum[child]) != 1 or int(model.jnt_type[first]) != BALL:
            return None
        turned = np.zeros(3)
        mujoco.mju_rotVecQuat(turned, model.jnt_pos[first], model.body_quat[child])
        points.append(model.body_pos[child] + turned)
    for index in range(model.neq):
        ends = [point for tied, point in tied_points(model, index) if tied == body]
        if ends and (not model.eq_active0[index] or int(model.eq_type[index]) == WELD):
            return None
        points += ends
    return points


def _unit(v: np.ndarray) -> np.ndarray | None:
    """Return a vector's direction, or None for the zero vector."""
    length = float(np.linalg.norm(v))
    return v / length if length > 0 else None


def _in_line(lines: list) -> bool:
    """Return True if all directions are parallel to 1e-6 rad."""
    return all(line is not None and np.linalg.norm(np.cross(lines[0], line)) <= 1e-6 for line in lines)


def extent_m(model: mujoco.MjModel) -> float:
    """Return a model's extent [m]: MuJoCo's own, or the size of the moving bodies if the two differ by a factor above 3.

    The size is the largest side of the box around the moving bodies. A floor, or a statistic in the file, can falsify
    MuJoCo's own extent.
    """
    stated = float(model.stat.extent)
    data = data_at(model)
    moving = np.flatnonzero(np.asarray(model.body_weldid) != 0)
    points = [data.xpos[moving], data.xipos[moving], data.xanchor]
    geoms = np.isin(model.geom_bodyid, moving)
    for sign in (1.0, -1.0):
        points.append(data.geom_xpos[geoms] + sign * model.geom_rbound[geoms, None])
    for index in range(model.neq):
        for body, place in tied_points(model, index):
            points.append(in_world(data, body, place)[None])
    box = np.ptp(np.vstack(points), axis=0)
    size = float(box.max()) if len(moving) else 0.0
    return stated if size <= 0 or size / 3.0 <= stated <= size * 3.0 else size


def clamped_joints(model: mujoco.MjModel, site: int) -> list[int]:
    """Return the joints that move a site and whose actuatorfrcrange clamps motor efforts plus a force on the site."""
    bodies = reversed(path_to(model, int(model.site_bodyid[site])))
    return [joint for body in bodies for joint in joints_of(model, body) if model.jnt_actfrclimited[joint]]
