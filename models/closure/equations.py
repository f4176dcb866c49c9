"""Loop closure: the equations phi(q) = 0 of a model's equality constraints.

A connect makes two points coincide (three rows). A weld makes two frames coincide (six rows). A joint or tendon equality
makes a position or length a quartic polynomial of another (one row). The residuals are MuJoCo's own, with three changes that
keep their zeros:

* All rows are lengths [m]. A weld's rotation rows are 2 sin(theta / 2) axis times the mechanism's extent, and the row of a
  joint equality on a hinge is the angle times the extent. Forces on all rows are therefore newtons, and one tolerance
  applies to all rows.
* The rows lie along the axes of the nearest body that carries both tied bodies. A planar loop on a moving leg therefore
  keeps its two independent rows when the leg turns.
* A second connect between the same two bodies has only the rows normal to the line through the two pins (`_second_pin`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import ModelError
from linkplan.models.kinematics import disabled, extent_m, tied_points
from linkplan.models.symbolic_model import is_zero, number, numeric
from linkplan.models.tree.coordinates import product
from linkplan.models.tree.dynamics import HINGE, Frame, Tree, common_ancestor, frame_in
from linkplan.models.tree.tendons import LACKING, is_fixed, tendon_joints, tendon_label

CONNECT, WELD = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
JOINT, TENDON = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Closure:
    """One gap of an equality constraint: the rows of phi [m] that form one vector.

    A weld has two gaps, its point and its orientation. `unit` is the gap's natural unit, "m" or "rad", and `per_unit` the
    length [m] of one such unit in the rows: an angle's lever, or a tendon's largest moment arm. The rows lie along the axes
    of body `frame` (0 is the world). MuJoCo's own residual times `scale` is `residual`.
    """

    name: str
    kind: str  # "point", "orientation", "joint" or "tendon"
    index: int  # of MuJoCo's equality constraint
    rows: slice
    residual: ca.SX
    frame: int
    scale: float
    unit: str
    per_unit: float

    def gap(self, phi: np.ndarray) -> np.ndarray:
        """Return the size of the gap [`unit`] from values of all rows (..., n_rows)."""
        return np.linalg.norm(phi[..., self.rows], axis=-1) / self.per_unit


def gaps_by_unit(closures: Sequence[Closure], phi: np.ndarray) -> dict[str, np.ndarray]:
    """Return the largest gap (...,) of the closures in each unit, "m" or "rad", from all rows (..., n_rows)."""
    found: dict[str, np.ndarray] = {}
    for closure in closures:
        gap = closure.gap(phi)
        found[closure.unit] = np.maximum(found.get(closure.unit, gap), gap)
    return dict(sorted(found.items()))


def read_closures(model: mujoco.MjModel, tree: Tree) -> tuple[Closure, ...]:
    """Return the active loop closures of a model.

    Raises:
        ModelError: if an active equality constraint is of another kind.
    """
    closures: list[Closure] = []
    if disabled(model, mujoco.mjtDisableBit.mjDSBL_EQUALITY, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT):
        return ()
    for index in np.flatnonzero(model.eq_active0).tolist():
        kind = mujoco.mjtEq(int(model.eq_type[index]))
        if kind not in _READERS:
            raise ModelError(
                f"equality constraint '{equality_name(model, index)}' is of kind"
                f" '{kind.name.removeprefix('mjEQ_').lower()}'; the planner closes loops by 'connect', 'weld', 'joint' and"
                " 'tendon'; mechanism.keep = [NAMES] reads the named chain without the rest of the scene"
            )
        for what, residual, frame, scale, (unit, per_unit) in _READERS[kind](model, tree, index):
            start = closures[-1].rows.stop if closures else 0
            closures.append(
                Closure(
                    name=equality_name(model, index),
                    kind=what,
                    index=index,
                    rows=slice(start, start + residual.numel()),
                    residual=residual,
                    frame=frame,
                    scale=scale,
                    unit=unit,
                    per_unit=per_unit,
                )
            )
    return tuple(closures)


def equality_name(model: mujoco.MjModel, index: int) -> str:
    """Return the constraint's own name, or a name made from the two elements that it ties."""
    name = model.equality(index).name
    if name:
        return name
    kind = mujoco.mjtEq(int(model.eq_type[index]))
    elements = {JOINT: model.joint, TENDON: model.tendon}
    at_sites = int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE)
    element = elements.get(kind, model.site if at_sites else model.body)
    if kind not in (CONNECT, WELD, *elements):
        return f"equality {index}"
    tied = [int(i) for i in (model.eq_obj1id[index], model.eq_obj2id[index]) if i >= 0]
    return "-".join(element(i).name or str(i) for i in tied)


def _common_frames(model: mujoco.MjModel, tree: Tree, bodies: list[int]) -> tuple[int, list[Frame]]:
    ancestor = common_ancestor(model, *bodies)
    return ancestor, [frame_in(tree, ancestor, body) for body in bodies]


def _connect(model: mujoco.MjModel, tree: Tree, index: int):
    ends = tied_points(model, index)
    frame, frames = _common_frames(model, tree, [body for body, _ in ends])
    first, second = _places(frames, ends)
    earlier = earlier_pin(model, index)
    if earlier is not None:
        pins = [tied_points(model, earlier), tied_points(numeric(model), earlier)]
        before, own = (pin if pin[0][0] == ends[0][0] else pin[::-1] for pin in pins)  # in the same order of bodies
        own = np.array([[place for _, place in pin] for pin in (own, tied_points(numeric(model), index))])
        residual = _second_pin(_places(frames, before), (first, second), own, tree)
        if residual is not None:
            yield "point", residual, frame, 1.0, ("m", 1.0)
            return
    yield "point", first - second, frame, 1.0, ("m", 1.0)


def _second_pin(first: tuple[ca.SX, ca.SX], second: tuple[ca.SX, ca.SX], places: np.ndarray, tree: Tree) -> ca.SX | None:
    """Return phi_2 (3,) [m] of a second pin between the same two bodies, or None if the pin's own residual serves.

    Two connects between two bodies form a hinge. Let d be the vector from pin to pin in one body, d_0 in the other, and R
    the relative rotation. The two residuals differ by delta = R d - d_0, and since d and d_0 have the same length,

        (R d + d_0) . delta = 0.

    Five of the six rows are therefore independent, but the dependent combination changes with the pose. The same rows serve
    at every pose if the second pin only has the components normal to d_0,

        phi_2 = phi_1 + (I - e e^T) delta,   e = d_0 / |d_0|.

    Together with phi_1 this vanishes where R d = d_0, as before (and where R d = -d_0, half a turn away), and has the same
    Jacobian there.

    Args:
        first: the positions (3,) [m] of the first pin's two ends, expressions of q in the axes of one of the bodies or of
            their common carrier.
        second: the positions of the second pin's ends, with the bodies in the same order.
        places: the positions of both pins in both bodies' own frames (2 pins, 2 bodies, 3) [m].
        tree: of the bodies.
    """
    long = np.linalg.norm(places[1] - places[0], axis=-1)
    if min(long) == 0 or abs(long[0] - long[1]) > 1e-10 * max(long):
        return None  # the two pins cannot both close, and all rows are needed
    ways = [later - earlier for earlier, later in zip(first, second, strict=True)]
    still = [way for way in ways if not ca.depends_on(way, tree.q)]
    if len(still) != 1:
        return None
    delta, still_zero = ways[0] - ways[1], ca.SX.zeros(tree.displacement.numel())
    off, fixed = ca.substitute([delta, still[0]], [tree.displacement], [still_zero])
    pose = np.random.default_rng(0).uniform(-1.0, 1.0, tree.q.numel())
    others = [one for one in ca.symvar(off) if not ca.depends_on(tree.q, one)]
    at_random = ca.Function("delta", [tree.q, *others], [off])(pose, *range(1, len(others) + 1))
    if np.abs(np.array(at_random)).max() <= ROUNDING_SHARE * max(long):
        return None  # delta is zero at every pose
    e = fixed / ca.norm_2(fixed) if ca.symvar(fixed) else ca.evalf(fixed) / max(long)
    return first[0] - first[1] + (ca.DM.eye(3) - e @ e.T) @ delta


def earlier_pin(model: mujoco.MjModel, index: int) -> int | None:
    """Return the first active connect before `index` between the same two bodies, or None."""
    bodies = sorted(body for body, _ in tied_points(model, index))
    if int(model.eq_type[index]) != CONNECT or bodies[0] == bodies[1]:
        return None
    for other in range(index):
        if not model.eq_active0[other] or int(model.eq_type[other]) != CONNECT:
            continue
        if sorted(body for body, _ in tied_points(model, other)) == bodies:
            return other
    return None


def rows_by_pin(model: mujoco.MjModel, closures: Sequence[Closure]) -> list[list[int]]:
    """Return the rows of phi of each closure, followed by the rows of each pair of pins that forms a hinge."""
    rows = [(gap, list(range(gap.rows.start, gap.rows.stop))) for gap in closures]
    of = {gap.index: own for gap, own in rows if gap.kind == "point"}
    earlier = [(gap.index, earlier_pin(model, gap.index)) for gap in closures if gap.kind == "point"]
    pairs = [of[first] + of[index] for index, first in earlier if first in of]
    return [own for _, own in rows] + pairs


def _places(frames: list[Frame], ends: list[tuple[int, np.ndarray]]) -> tuple[ca.SX, ca.SX]:
    first, second = (frame.point(p) for frame, (_, p) in zip(frames, ends, strict=True))
    return first, second


def _weld(model: mujoco.MjModel, tree: Tree, index: int):
    """Yield the point's rows, and the orientation's rows unless `torquescale` is zero."""
    yield from _connect(model, tree, index)
    torquescale = float(model.eq_data[index, 10])
    if torquescale == 0:
        return
    bodies = [body for body, _ in tied_points(model, index)]
    _, (first, second) = _common_frames(model, tree, bodies)
    model = numeric(model)
    if int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE):
        turns = [model.site_quat[model.eq_obj1id[index]], model.site_quat[model.eq_obj2id[index]]]
    else:
        turns = [model.eq_data[index, 6:10] / np.linalg.norm(model.eq_data[index, 6:10]), np.array([1.0, 0, 0, 0])]
    q_1, q_2 = (product(f.quaternion, ca.SX(ca.DM(turn))) for f, turn in zip((first, second), turns, strict=True))
    relative = product(ca.vertcat(q_2[0], -q_2[1:]), q_1)
    lever = extent_m(model)
    # MuJoCo's rows are torquescale times the quaternion's vector part. The scalar part is 1 or -1 where the weld holds.
    yield "orientation", 2 * lever * relative[1:], bodies[1], 2 * lever / torquescale, ("rad", lever)


def _polynomial(model: mujoco.MjModel, index: int, y: ca.SX, x: ca.SX | None) -> ca.SX:
    a = [number(model.eq_data[index, k]) for k in range(5)]
    powers = range(5) if x is not None else range(1)
    return y - sum((a[k] * (x**k if k else 1) for k in powers if not is_zero(a[k])), ca.SX(0))


def _joint(model: mujoco.MjModel, tree: Tree, index: int):
    joints = [int(i) for i in (model.eq_obj1id[index], model.eq_obj2id[index]) if i >= 0]
    travels = [tree.q[int(model.jnt_dofadr[i])] - float(model.qpos0[model.jnt_qposadr[i]]) for i in joints]
    residual = _polynomial(model, index, travels[0], travels[1] if len(joints) > 1 else None)
    units = [("rad", extent_m(numeric(model))) if int(model.jnt_type[i]) == HINGE else ("m", 1.0) for i in joints]
    yield _coupling("joint", model, index, residual, units)


def _coupling(kind: str, model: mujoco.MjModel, index: int, residual: ca.SX, units: list[tuple[str, float]]):
    """Return the gap of a coupling y = a_0 + a_1 x + ... as a length of whichever of the two moves less [m].

    The gap of a screw is thus the same whether its nut follows its motor or its motor its nut, and its row is no larger than
    those of other closures. `units` are the unit of y, and of x if there is one, with the length [m] of one such unit.
    """
    slope = abs(float(numeric(model).eq_data[index, 1])) if len(units) > 1 else 0.0
    if units[0][1] * slope > units[-1][1]:
        scale = units[1][1] / slope
        return kind, residual * scale, 0, scale, units[1]
    return kind, residual * units[0][1], 0, units[0][1], units[0]


def _tendon(model: mujoco.MjModel, tree: Tree, index: int):
    tendons = [int(i) for i in (model.eq_obj1id[index], model.eq_obj2id[index]) if i >= 0]
    for tendon in tendons:
        if tree.tendon_lengths[tendon] is None:
            raise ModelError(
                f"equality constraint '{equality_name(model, index)}' ties tendon '{tendon_label(model, tendon)}', which"
                f" {LACKING}"
            )
    travels = [tree.tendon_lengths[tendon] - float(model.tendon_length0[tendon]) for tendon in tendons]
    residual = _polynomial(model, index, travels[0], travels[1] if len(tendons) > 1 else None)
    kind, length, frame, scale, _ = _coupling("tendon", model, index, residual, [("m", 1.0)] * len(tendons))
    moved, most = tendons[0] if scale == 1.0 else tendons[1], ("m", 1.0)
    if is_fixed(model, moved):  # the unit of the joint with the largest coefficient, and that
        arms = tendon_joints(numeric(model), moved)
        dof = max(arms, key=lambda one: abs(arms[one]))
        most = "rad" if int(model.jnt_type[model.dof_jntid[dof]]) == HINGE else "m", abs(arms[dof]) or 1.0
    yield kind, length, frame, scale, most


_READERS = {CONNECT: _connect, WELD: _weld, JOINT: _joint, TENDON: _tendon}
