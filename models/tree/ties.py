"""What a model's equality constraints tie: points of two bodies."""

import mujoco
import numpy as np

CONNECT, WELD = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)


def tied_points(model: mujoco.MjModel, index: int) -> list[tuple[int, np.ndarray]]:
    """Return the two points that a connect or weld ties, each as its body and its place (3,) [m] in that body's frame.

    An equality of another kind ties no points: the list is empty.
    """
    kind = int(model.eq_type[index])
    if kind not in (CONNECT, WELD):
        return []
    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE):
        return [(int(model.site_bodyid[site]), model.site_pos[site]) for site in (first, second)]
    points = [model.eq_data[index, 0:3], model.eq_data[index, 3:6]]
    if kind == WELD:  # whose data name the second body's point first
        points.reverse()
    return [(first, points[0]), (second, points[1])]


def rod_line(model: mujoco.MjModel, joint: int) -> np.ndarray | None:
    """Return the line (3,) about which a body on a ball joint may spin, in its frame, or None where it has none.

    That of a rod: nothing hangs on it, and its connects tie it at one point, or at points in line with the joint.
    """
    body = int(model.jnt_bodyid[joint])
    if int(model.body_jntnum[body]) != 1 or np.any(model.body_parentid == body):
        return None
    arms = []
    for index in range(model.neq):
        ends = [point for tied, point in tied_points(model, index) if tied == body]
        if ends and (not model.eq_active0[index] or int(model.eq_type[index]) == WELD):
            return None
        arms += [point - model.jnt_pos[joint] for point in ends]
    lengths = [float(np.linalg.norm(arm)) for arm in arms]
    if not arms or min(lengths) == 0:
        return None
    lines = [arm / length for arm, length in zip(arms, lengths, strict=True)]
    if any(np.linalg.norm(np.cross(lines[0], line)) > 1e-6 for line in lines):
        return None
    return lines[0]
