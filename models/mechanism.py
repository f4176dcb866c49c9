"""A closed-chain mechanism: a MuJoCo model, its joints, closures and actuators, and its reduced dynamics."""

import copy
import hashlib
import numbers
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np

from models import newton
from models.actuators import Actuator, read_actuators
from models.closure import dependent_columns, independent_rows, numerical_rank, read_closures
from models.errors import AssemblyError, ModelError
from models.library import compile_model
from models.names import nearest
from models.payload import BODY_NAME, Payload, payload_from
from models.reduction import ReducedDynamics, reduce_tree
from models.tree import HINGE, SLIDE, Inertial, build_tree

# Joint angles named in `home` beside the independent ones choose a branch; the loop may settle this far from them.
HOME_TOLERANCE = np.radians(5.0)
# No joint is asked to stand further out than this [rad or m].
_FARTHEST = 1e3
# A step from the home pose to look whether it is an ordinary one [rad; on a slide, of the model's extent].
_HOME_STEP = 0.02


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Joint:
    """A hinge [rad] or slide [m] with its range, infinite where the model sets none."""

    name: str
    kind: str  # "hinge" or "slide"
    lower: float
    upper: float

    @property
    def unit(self) -> str:
        """The unit of the joint's position in files and messages."""
        return "deg" if self.kind == "hinge" else "m"

    def shown(self, position: float) -> float:
        """Return a position [rad or m] in the unit of files and messages."""
        return float(np.degrees(position)) if self.kind == "hinge" else float(position)

    def read(self, value: float) -> float:
        """Return a value in the unit of files and messages as a position [rad or m]."""
        return float(np.radians(value)) if self.kind == "hinge" else float(value)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Mechanism:
    """A mechanism assembled at its home pose.

    `independent` and `dependent` are indices into the joints; `home` (n_q,) closes the loops; `home_gap_m` is how far
    they stood open at the model's own reference pose, before assembly.
    """

    name: str
    model: mujoco.MjModel
    payload: Payload | None
    joints: tuple[Joint, ...]
    actuators: tuple[Actuator, ...]
    closure_names: tuple[str, ...]
    closure_rows: np.ndarray  # independent rows of phi
    independent: np.ndarray
    dependent: np.ndarray
    home: np.ndarray
    reference: np.ndarray
    home_gap_m: float
    dynamics: ReducedDynamics

    @property
    def n_q(self) -> int:
        """The number of joints."""
        return len(self.joints)

    @property
    def dof(self) -> int:
        """The degrees of freedom, n_q less the rank of the closure."""
        return len(self.independent)

    @property
    def n_u(self) -> int:
        """The number of usable actuators."""
        return len(self.actuators)

    @property
    def independent_joints(self) -> tuple[Joint, ...]:
        """The joints whose positions are the reduced coordinates s."""
        return tuple(self.joints[i] for i in self.independent)

    @property
    def effort_limit(self) -> np.ndarray:
        """The actuators' limits (n_u, 2) [N.m or N]."""
        return np.array([[a.lower, a.upper] for a in self.actuators]).reshape(-1, 2)

    def fingerprint(self, *, payload_apart: bool = False) -> str:
        """Return a hash of all that the reduced dynamics depend on: the compiled model and the choice of coordinates.

        With `payload_apart` payloads on one body have one hash, as they have one `parametric_dynamics`.
        """
        model = self.model
        if payload_apart and self.payload is not None:
            model = copy.copy(model)
            body = model.body(BODY_NAME).id
            model.body_mass[body], model.body_inertia[body] = 1.0, 1.0
            model.body_ipos[body], model.body_iquat[body] = 0.0, [1.0, 0.0, 0.0, 0.0]
            mujoco.mj_setConst(model, mujoco.MjData(model))  # what the compiler derived from them
            model.stat.meanmass, model.stat.meaninertia = 1.0, 1.0  # means over bodies, which the simulator alone uses
        content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
        mujoco.mj_saveModel(model, None, content)
        digest = hashlib.sha256(content.tobytes())
        for choice in (self.independent, self.dependent, self.closure_rows):
            digest.update(choice.tobytes() + b"|")
        return digest.hexdigest()

    def parametric_dynamics(self) -> ReducedDynamics:
        """Return the reduced dynamics with the payload's numbers (7,) as every function's last input.

        Raises:
            ModelError: when there is no payload.
        """
        if self.payload is None:
            raise ModelError(f"mechanism '{self.name}' has no payload to vary")
        pi = ca.SX.sym("payload", len(self.payload.numbers()))
        own = Inertial(mass=pi[0], com=pi[1:4], inertia=ca.diag(pi[4:7]))
        tree = build_tree(self.model, {self.model.body(BODY_NAME).id: own})
        phi = ca.vertcat(ca.SX(0, 1), *[closure.residual for closure in read_closures(self.model, tree)])
        matrix = _effort_matrix(self.n_q, self.actuators)
        return reduce_tree(tree, phi, matrix, self.closure_rows, self.independent, self.dependent, pi)

    def joint_index(self, name: str, error: type[Exception] = ModelError) -> int:
        """Return the index of a joint by name."""
        names = [joint.name for joint in self.joints]
        if name not in names:
            raise error(
                f"joint '{name}' is not in mechanism '{self.name}'{nearest(name, names)}; joints are {', '.join(names)}"
            )
        return names.index(name)

    def closure_slice(self, closure: int) -> slice:
        """Return where a closure's rows stand among all rows."""
        return slice(3 * closure, 3 * closure + 3)

    def gap_m(self, q: np.ndarray) -> float:
        """Return the largest distance [m] between two points that a closure ties, at pose q (n_q,)."""
        phi = np.array(self.dynamics.closure(q)).reshape(-1, 3)
        return float(np.linalg.norm(phi, axis=1).max(initial=0.0))


def load_mechanism(
    source: str | Path,
    *,
    payload: Payload | str | Mapping | None = None,
    home: Mapping[str, float] | None = None,
) -> Mechanism:
    """Return the mechanism of a built-in name, an MJCF file or MJCF text, assembled.

    Args:
        source: a built-in name, a path, or MJCF text.
        payload: a `Payload`, a built-in payload's name, or a table with body, mass_kg, com_m, inertia_kgm2.
        home: joint positions by name [rad or m] at which to assemble. Independent joints are held there; the others
            choose the branch. Without it the model's keyframe "home", else its reference pose, is the guess.

    Raises:
        ModelError: when the model cannot be used.
        AssemblyError: when its loops do not close at, or near, the pose asked.
    """
    payload = payload_from(payload)
    name, model = compile_model(source, payload)
    joints = _read_joints(name, model)
    tree = build_tree(model)
    closures = read_closures(model, tree)
    actuators = read_actuators(model)
    phi = ca.vertcat(ca.SX(0, 1), *[closure.residual for closure in closures])
    loop = ca.Function("loop", [tree.q], [ca.densify(phi), ca.densify(ca.jacobian(phi, tree.q))])

    reference = _reference_pose(model)
    asked = _asked_home(name, joints, home)
    pose = _assemble_home(name, joints, loop, reference, asked)
    jacobian = np.array(loop(pose)[1]).reshape(-1, len(joints))
    rank = numerical_rank(jacobian)
    if rank == len(joints):
        raise ModelError(
            f"mechanism '{name}' is locked: {len(joints)} joints less {rank} independent closure rows leave 0 degrees of"
            " freedom"
        )
    rows = independent_rows(jacobian, rank)
    actuated = list(dict.fromkeys(actuator.joint for actuator in actuators))
    dependent = dependent_columns(jacobian[rows], rank, last=actuated)
    independent = np.array([i for i in range(len(joints)) if i not in dependent], dtype=int)
    _refuse_singular_home(name, joints, loop, pose, rank, independent, float(model.stat.extent))
    dynamics = reduce_tree(tree, phi, _effort_matrix(len(joints), actuators), rows, independent, dependent)

    mechanism = Mechanism(
        name=name,
        model=model,
        payload=payload,
        joints=joints,
        actuators=actuators,
        closure_names=tuple(closure.name for closure in closures),
        closure_rows=rows,
        independent=independent,
        dependent=dependent,
        home=pose,
        reference=reference,
        home_gap_m=0.0,
        dynamics=dynamics,
    )
    object.__setattr__(mechanism, "home_gap_m", mechanism.gap_m(reference))
    for array in (mechanism.home, mechanism.reference, rows, independent, dependent):
        array.flags.writeable = False
    return mechanism


def _read_joints(name: str, model: mujoco.MjModel) -> tuple[Joint, ...]:
    if model.njnt == 0:
        raise ModelError(f"model '{name}' has no joint: there is nothing to move")
    joints = []
    for index in range(model.njnt):
        label = model.joint(index).name or f"joint{index}"
        kind = int(model.jnt_type[index])
        if kind not in (HINGE, SLIDE):
            spelled = mujoco.mjtJoint(kind).name.removeprefix("mjJNT_").lower()
            raise ModelError(f"joint '{label}' of model '{name}' is of type {spelled}; joints are hinge or slide")
        limited = bool(model.jnt_limited[index]) and not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        lower, upper = model.jnt_range[index] if limited else (-np.inf, np.inf)
        joints.append(Joint(name=label, kind="hinge" if kind == HINGE else "slide", lower=float(lower), upper=float(upper)))
    return tuple(joints)


def _effort_matrix(n_q: int, actuators: tuple[Actuator, ...]) -> np.ndarray:
    matrix = np.zeros((n_q, len(actuators)))
    for column, actuator in enumerate(actuators):
        matrix[actuator.joint, column] = actuator.gear
    return matrix


def _reference_pose(model: mujoco.MjModel) -> np.ndarray:
    """Return the keyframe "home" of the model, or its reference pose `qpos0`."""
    for key in range(model.nkey):
        if model.key(key).name == "home":
            return np.array(model.key_qpos[key], dtype=float)
    return np.array(model.qpos0, dtype=float)


def _asked_home(name: str, joints: tuple[Joint, ...], home: Mapping[str, float] | None) -> dict[int, float]:
    names = [joint.name for joint in joints]
    asked = {}
    for joint, value in (home or {}).items():
        if joint not in names:
            raise ModelError(
                f"joint '{joint}' is not in mechanism '{name}'{nearest(joint, names)}; joints are {', '.join(names)}"
            )
        number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        if not number or not abs(value) < _FARTHEST:
            raise ModelError(f"home of joint '{joint}' is a finite position within {_FARTHEST:g} rad or m, got {value!r}")
        asked[names.index(joint)] = float(value)
    return asked


def _assemble_home(name, joints, loop: ca.Function, reference: np.ndarray, asked: dict[int, float]) -> np.ndarray:
    """Return a pose that closes every loop, with the asked joints held as far as the loops leave them free.

    From the reference pose along a straight line to the asked one where that closes, which stays on the reference's
    branch; else by Newton from the asked values, which then choose the branch.
    """

    def residual(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi, jacobian = loop(q)
        return np.array(phi).ravel(), np.array(jacobian).reshape(-1, len(joints))

    everything = list(range(len(joints)))
    near, gap = newton.close(residual, reference, everything)
    if not asked:
        if gap > newton.CLOSED_M:
            gap = min(gap, newton.least_gap(residual, near, everything))
            raise AssemblyError(
                f"mechanism '{name}' does not close from its reference pose: the loop stays open by {1e3 * gap:.3g} mm;"
                " name a pose near a closed one with mechanism.home_deg"
            )
        return near
    base = near if gap <= newton.CLOSED_M else reference
    start = np.array([asked.get(i, base[i]) for i in everything])
    unnamed = [i for i in everything if i not in asked]
    poses = []
    if gap <= newton.CLOSED_M:
        poses.append(newton.follow(residual, near, asked))
    # Where more joints are named than the loop leaves free, the first are held and the others choose the branch. Unnamed
    # joints may start on another branch than the reference's: each is tried all round as well.
    starts = [start, *(_turned(joints, start, unnamed) if len(asked) > 1 else [])]
    for n_held in range(len(asked), 0, -1):
        held = list(asked)[:n_held]
        free = [i for i in everything if i not in held]
        for trial in starts:
            guess = newton.close(residual, trial, unnamed)[0] if n_held < len(asked) and unnamed else trial
            poses.append(newton.close(residual, guess, free))
            for pose, open_by in poses:
                away = max(abs(pose[i] - value) for i, value in asked.items())
                if open_by <= newton.CLOSED_M and away <= HOME_TOLERANCE:
                    return pose
            poses.clear()
    gap = min(newton.least_gap(residual, trial, unnamed) for trial in starts)
    where = ", ".join(f"{joints[i].name} = {joints[i].shown(v):.6g} {joints[i].unit}" for i, v in asked.items())
    raise AssemblyError(f"mechanism '{name}' does not close at {where}: the loop stays open by {1e3 * gap:.3g} mm")


def _turned(joints, start: np.ndarray, unnamed: list[int]) -> list[np.ndarray]:
    """Return `start` with its unnamed hinges turned by quarters, together: places to look for another branch from."""
    hinges = [i for i in unnamed if joints[i].kind == "hinge"]
    turned = []
    for quarter in (1, 2, 3) if hinges else ():
        trial = np.array(start)
        trial[hinges] += quarter * np.pi / 2
        turned.append(trial)
    return turned


def _refuse_singular_home(name, joints, loop: ca.Function, pose, rank: int, independent, extent: float) -> None:
    """Refuse a home pose where the rank is not that of its neighbours, or from which nothing can move.

    A parallelogram drawn flat, or a truss of three bars in a line, shows fewer independent rows there than it has.
    """

    def residual(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi, jacobian = loop(q)
        return np.array(phi).ravel(), np.array(jacobian).reshape(-1, len(joints))

    for index in independent:
        moved = False
        step = _HOME_STEP * (1.0 if joints[index].kind == "hinge" else extent)
        for change in (step, -step):
            trial = np.array(pose)
            trial[index] += change
            held = [int(i) for i in independent]
            neighbour, gap = newton.close(residual, trial, [i for i in range(len(joints)) if i not in held])
            if gap > newton.CLOSED_M:
                continue
            moved = True
            there = numerical_rank(residual(neighbour)[1])
            if there != rank:
                raise AssemblyError(
                    f"mechanism '{name}' is assembled in a singular pose: its closure has rank {rank} there and {there} next"
                    " to it; name another pose with mechanism.home_deg"
                )
        if not moved and rank:
            raise AssemblyError(
                f"mechanism '{name}' cannot move joint {joints[index].name} from its home pose: the loop is singular or"
                " locked there; name another pose with mechanism.home_deg"
            )
