"""A closed-chain mechanism: a MuJoCo model, its joints, closures and actuators, and its reduced dynamics."""

import functools
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator, effort_matrix, lengths, read_actuators
from linkplan.models.actuation.transmission import TRN_TENDON
from linkplan.models.closure.closed_pose import locked_or_singular, with_closed_pose
from linkplan.models.closure.equations import Closure, gaps_by_unit, read_closures
from linkplan.models.closure.initial_assembly import assemble, home_positions, nearby_poses, refuse_singular_assembly
from linkplan.models.closure.locked import refuse_locked
from linkplan.models.closure.mobility import closure_tolerance, judge_mobility, lost_freedoms
from linkplan.models.closure.nearest_pose import nearest_closed_pose
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.passive_freedom import find_passive_dofs, round_spins
from linkplan.models.closure.rank import dependent_columns, independent_rows, numerical_rank
from linkplan.models.closure.redundancy import ProjectedLoops, projected_loops
from linkplan.models.digest import compiled_bytes
from linkplan.models.errors import AssemblyError, LockedError, ModelError, UnassembledError
from linkplan.models.library import compile_model
from linkplan.models.payload import BODY_NAME, Payload, payload_from
from linkplan.models.pickling import packed, unpacked
from linkplan.models.reduction.reduced import ReducedDynamics, reduce_tree, with_numbers
from linkplan.models.reduction.regular_inertia import refuse_singular_inertia
from linkplan.models.source_table import source_table
from linkplan.models.stiffness import set_softness
from linkplan.models.tree.coordinates import Coordinates
from linkplan.models.tree.dynamics import build_tree
from linkplan.models.tree.friction import friction_notes, transition_speed
from linkplan.models.tree.joints import Joint, index_of, read_joints
from linkplan.models.tree.newton_euler import Inertial
from linkplan.models.tree.size import extent_m
from linkplan.models.tree.tendons import TendonLimit, is_fixed, limited_tendons, tendon_joints
from linkplan.models.urdf import conversion_notes

# A named choice of coordinates is refused where a column of J_z is left with less than this share of itself: the pose
# is then within some microradians of a dead centre of the choice.
_SINGULAR_CHOICE = 1e-6
# Jacobians away from home show so many times the noise of the file that home's does.
_NOISE_ROOM = 1e4
# The rank at the reference pose means something where the loops are closed there, up to a file's rounding.
_CLOSED_REFERENCE_M = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Mechanism:
    """A mechanism assembled at its home pose.

    Its coordinates q (n_q,) are internal ones, see `models.tree.coordinates`; `independent` and `dependent` are indices into
    them. `home` (n_q,) closes the loops; `home_gap_m` is how far they stood open at the model's own reference pose, before
    assembly; `closed_m` is the gap [m] below which they count as closed, more than rounding where the file's own numbers
    leave more. Overconstrained loops are `projected`: closed in the normal equations of all their rows. `passive_dofs` are
    passive degrees of freedom: independent coordinates that can move alone while all other bodies rest and
    that no actuator drives, as a rod between two ball joints spins; `notes` are sentences on what is worth knowing of the
    assembly. `source` is what it was loaded from, as the [mechanism] table of a problem file.
    """

    name: str
    model: mujoco.MjModel
    payload: Payload | None
    joints: tuple[Joint, ...]
    actuators: tuple[Actuator, ...]
    tendons: tuple[TendonLimit, ...]  # whose lengths are limited
    closures: tuple[Closure, ...]
    closure_rows: np.ndarray  # rows of phi that are independent at home
    projected: tuple[ProjectedLoops, ...]
    independent: np.ndarray
    dependent: np.ndarray
    home: np.ndarray
    reference: np.ndarray
    home_gap_m: float
    closed_m: float
    extent_m: float  # of what moves: a length to compare lengths with
    dynamics: ReducedDynamics
    parametric: ReducedDynamics | None  # with the payload's numbers as inputs, where there is one
    friction_transition: float  # the speed of dry friction, see `models.tree.friction`
    coordinates: Coordinates
    passive_dofs: tuple[int, ...]
    notes: tuple[str, ...]
    source: Mapping[str, object]

    def __reduce__(self) -> tuple:
        return unpacked, (Mechanism, packed(self))

    @property
    def n_q(self) -> int:
        """The number of internal coordinates: joints, a ball joint counted thrice."""
        return len(self.joints)

    @property
    def closure_names(self) -> tuple[str, ...]:
        """The names of the equality constraints that close the loops."""
        return tuple({closure.index: closure.name for closure in self.closures}.values())

    @property
    def n_closure_rows(self) -> int:
        """The number of closure equations, redundant ones among them."""
        return self.closures[-1].rows.stop if self.closures else 0

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

    @property
    def cyclic(self) -> np.ndarray:
        """Which independent coordinates (n_s,) are passive degrees of freedom of round bodies: nothing depends on them."""
        return round_spins(self.dynamics, self.home, np.isin(self.independent, self.passive_dofs))

    def fingerprint(self, *, payload_apart: bool = False) -> str:
        """Return a hash of all that the reduced dynamics depend on: the compiled model and the choice of coordinates.

        With `payload_apart` payloads on one body have one hash, as they have one `parametric_dynamics`.
        """
        return _fingerprint(self, payload_apart)

    def parametric_dynamics(self) -> ReducedDynamics:
        """Return the reduced dynamics with the payload's numbers (7,) as every function's last input.

        Raises:
            ModelError: when there is no payload.
        """
        if self.parametric is None:
            raise ModelError(f"mechanism '{self.name}' has no payload to vary")
        return self.parametric

    def joint_index(self, name: str, error: type[Exception] = ModelError) -> int:
        """Return the index of a joint by name."""
        return index_of(self.name, self.joints, name, error)

    def closure_slice(self, closure: int) -> slice:
        """Return where the force [N] of a closure of `closure_names` stands among all rows: a weld's at its point."""
        name = list(dict.fromkeys(gap.index for gap in self.closures))[closure]
        return next(gap.rows for gap in self.closures if gap.index == name)

    def gap_m(self, q: np.ndarray) -> float:
        """Return the largest gap [m] of any closure at pose q (n_q,), an angle by what it moves at the model's extent."""
        return float(self.gaps_m(np.asarray(q)[None])[0])

    def gaps_m(self, q: np.ndarray) -> np.ndarray:
        """Return the largest gap (n,) [m] of any closure at each of the poses q (n, n_q)."""
        phi = self._closure(q)
        return np.max([np.zeros(len(q)), *(np.linalg.norm(phi[:, one.rows], axis=1) for one in self.closures)], axis=0)

    def gaps_by_unit(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Return the largest gap (n,) of closures at poses q (n, n_q) by unit: "m" of points and slides, "rad" of angles."""
        return gaps_by_unit(self.closures, self._closure(q))

    def _closure(self, q: np.ndarray) -> np.ndarray:
        return np.array(self.dynamics.closure.map(len(q))(np.asarray(q, dtype=float).T)).T

    def qpos_of(self, q: np.ndarray) -> np.ndarray:
        """Return MuJoCo's qpos (..., nq) of poses q (..., n_q)."""
        return self.coordinates.qpos_of(q)

    def q_of(self, qpos: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return the poses q (..., n_q) of MuJoCo's qpos (..., nq); what turns for ever by whole turns `near` a pose."""
        return self.coordinates.q_of(qpos, near)

    def qvel_of(self, q: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return MuJoCo's qvel (..., nv) of poses and their rates q' (..., n_q)."""
        return self.coordinates.qvel_of(q, rates)

    def rates_of(self, q: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Return the rates q' (..., n_q) of poses q under MuJoCo's qvel (..., nv)."""
        return self.coordinates.rates_of(q, qvel)


@functools.lru_cache(maxsize=64)
def _fingerprint(mechanism: Mechanism, payload_apart: bool) -> str:
    apart = BODY_NAME if payload_apart and mechanism.payload is not None else None
    digest = hashlib.sha256(compiled_bytes(mechanism.model, apart))
    for choice in (mechanism.independent, mechanism.dependent, mechanism.closure_rows):
        digest.update(choice.tobytes() + b"|")
    digest.update(np.float64(mechanism.friction_transition).tobytes())
    return digest.hexdigest()


def load_mechanism(
    source: str | Path,
    *,
    payload: Payload | str | Mapping | None = None,
    home: Mapping[str, float] | None = None,
    independent: Sequence[str] | None = None,
    solref: str | None = None,
    closure_tolerance_m: float | None = None,
    friction_transition: float | None = None,
) -> Mechanism:
    """Return the mechanism of a built-in name, an MJCF file or MJCF text, assembled.

    Args:
        source: a built-in name, a path, or MJCF text.
        payload: a `Payload`, a built-in payload's name, or a table with body, mass_kg, com_m, inertia_kgm2.
        home: joint positions by name [rad or m] at which to assemble. Independent joints are held there; the others
            choose the branch. Without it the model's keyframe "home", else its reference pose, is the guess.
        independent: names of joints to be independent coordinates; by default the actuated ones are, as far as they can.
        solref: "stiff" for the stiffest equality constraints in simulation that the timestep admits; by default the model's.
        closure_tolerance_m: the gap [m] up to which a motion that the file's rounding alone forbids is free; by default a
            micrometre, or a hundred thousandth of a small mechanism.
        friction_transition: the speed [rad/s; on a slide or tendon, of the mechanism's extent a second] about which dry
            friction goes over from one direction to the other; by default two degrees a second.

    Raises:
        ModelError: when the model cannot be used, or the named joints cannot be its coordinates.
        InertiaError: when a motion of its joints moves no mass at home.
        AssemblyError: when its loops do not close at, or near, the pose asked.
    """
    if independent is not None:
        _names_of(independent)
    asked = {"independent": independent, "closure_tolerance_m": closure_tolerance_m, "solref": solref}
    payload = payload_from(payload)
    name, model = compile_model(source, payload)
    set_softness(model, solref)
    if model.njnt == 0:
        raise ModelError(f"model '{name}' has no joint: there is nothing to move")
    reference_qpos = _reference_qpos(model)
    pi = None if payload is None else ca.SX.sym("payload", len(payload.numbers()))
    transition = transition_speed(friction_transition)
    if friction_transition is not None:
        asked["friction_transition_deg_s"] = float(np.degrees(transition))
    tree = build_tree(model, reference_qpos, _varied(model, pi), transition)
    joints = read_joints(name, model, tree.coordinates)
    closures = read_closures(model, tree)
    actuators = read_actuators(model)
    phi = ca.vertcat(ca.SX(0, 1), *[closure.residual for closure in closures])
    loop = KinematicLoop(
        function=ca.Function("loop", [tree.q], [ca.densify(phi), ca.densify(ca.jacobian(phi, tree.q))]),
        rows=tuple(closure.rows for closure in closures),
    )
    extent = extent_m(model)
    unit = np.array([1.0 if joint.kind == "hinge" else extent for joint in joints])  # what counts as a radian
    tolerance = closure_tolerance(closure_tolerance_m, extent)
    reference = tree.coordinates.q_of(reference_qpos)
    try:
        pose = assemble(name, joints, loop, reference, home_positions(name, joints, home), tolerance)
    except UnassembledError as error:
        raise with_closed_pose(error, joints, tree.coordinates, nearest_closed_pose(loop, joints, reference, unit)) from None
    _refuse_beyond_charts(name, tree.coordinates, pose)
    mobility = judge_mobility(loop, pose, unit, tolerance)
    loop, share = mobility.loop, mobility.loop.rank_tolerance
    about = nearby_poses(loop, pose, unit)
    jacobians = [loop.residual(q)[1] * unit for q in (pose, *about)]
    refuse_locked(name, len(joints), closures, jacobians[0], mobility, tolerance)
    rank = numerical_rank(jacobians[0], share)
    ordinary = [jacobian for jacobian in jacobians if numerical_rank(jacobian, share) == rank]
    rows = independent_rows(ordinary, rank, share)
    named = _named(name, joints, independent, len(joints) - rank)
    dependent = _choose_dependent(joints, model, jacobians[0][rows], rank, actuators, named)
    free = np.array([i for i in range(len(joints)) if i not in dependent], dtype=int)
    try:
        refuse_singular_assembly(name, joints, loop, pose, free, extent, about)
    except LockedError as error:
        raise locked_or_singular(error, joints, closures, loop, tree.coordinates, pose, unit) from None
    except UnassembledError as error:
        raise with_closed_pose(error, joints, tree.coordinates, nearest_closed_pose(loop, joints, pose, unit)) from None
    B = effort_matrix(model, tree, actuators)
    sparse = ca.Function("J", [tree.q], [ca.jacobian(phi, tree.q)])
    projected = projected_loops(
        sparse, rows.tolist(), dependent.tolist(), pose, mobility.noise * _NOISE_ROOM, inexact=bool(mobility.freed_m)
    )
    long = lengths(model, tree, actuators)
    parametric = reduce_tree(tree, closures, B, rows, free, dependent, pi, projected, long)
    dynamics = parametric if payload is None else with_numbers(parametric, payload.numbers())
    refuse_singular_inertia(name, joints, free, dynamics, pose)
    poses = [q for q, jacobian in zip((pose, *about), jacobians, strict=True) if numerical_rank(jacobian, share) == rank]
    passive_dofs, notes = (
        find_passive_dofs(model, joints, tree.coordinates, dynamics, free, poses, extent) if closures else ((), [])
    )
    notes += lost_freedoms(joints, actuators, dynamics, poses, mobility, tolerance)
    notes += [*friction_notes(model, transition, extent), *conversion_notes(source)]
    at_reference = numerical_rank(loop.residual(reference)[1] * unit, share)
    if loop.gap(loop.residual(reference)[0]) <= _CLOSED_REFERENCE_M and at_reference != rank:
        notes.append(f"the model's reference pose is singular: the closure has rank {at_reference} there and {rank} at home")

    mechanism = Mechanism(
        name=name,
        model=model,
        payload=payload,
        joints=joints,
        actuators=actuators,
        tendons=limited_tendons(model),
        closures=closures,
        closure_rows=rows,
        projected=projected,
        independent=free,
        dependent=dependent,
        home=pose,
        reference=reference,
        home_gap_m=loop.gap(loop.residual(reference)[0]),
        closed_m=loop.closed_m,
        extent_m=extent,
        dynamics=dynamics,
        parametric=None if payload is None else parametric,
        friction_transition=transition,
        coordinates=tree.coordinates,
        passive_dofs=passive_dofs,
        notes=tuple(notes),
        source=source_table(source, payload, home, joints, asked),
    )
    for array in (mechanism.home, mechanism.reference, rows, free, dependent):
        array.flags.writeable = False
    return mechanism


def _varied(model: mujoco.MjModel, numbers: ca.SX | None) -> dict[int, Inertial]:
    """Return the inertial parameters that a payload's numbers (7,) are; none where there is no payload."""
    varied = {} if numbers is None else {model.body(BODY_NAME).id: numbers}
    return {body: Inertial(mass=pi[0], com=pi[1:4], inertia=ca.diag(pi[4:7])) for body, pi in varied.items()}


def _reference_qpos(model: mujoco.MjModel) -> np.ndarray:
    """Return the keyframe "home" of the model, or its reference pose `qpos0`, as a qpos (nq,)."""
    for key in range(model.nkey):
        if model.key(key).name == "home":
            return np.array(model.key_qpos[key], dtype=float)
    return np.array(model.qpos0, dtype=float)


def _refuse_beyond_charts(name: str, coordinates: Coordinates, pose: np.ndarray) -> None:
    left = coordinates.range_violation(pose)
    if left is not None:
        raise AssemblyError(
            f"mechanism '{name}' assembles with {left}; give the model a keyframe 'home' near the pose meant"
        )


def _names_of(asked: object) -> None:
    """Refuse what is no list of joint names."""
    if not isinstance(asked, list | tuple) or not all(isinstance(joint, str) for joint in asked):
        raise ModelError(f"mechanism.independent is a list of joint names, got {asked!r}")


def _named(name: str, joints: tuple[Joint, ...], asked: Sequence[str] | None, dof: int) -> list[int]:
    """Return the indices of the joints named as independent coordinates."""
    if asked is None:
        return []
    named = [index_of(name, joints, joint) for joint in asked]
    if len(set(named)) < len(named) or len(named) > dof:
        raise ModelError(
            f"mechanism.independent names {len(named)} joints ({', '.join(asked)}); mechanism '{name}' has {dof} degrees of"
            " freedom, each a joint of its own"
        )
    return named


def _choose_dependent(joints, model, jacobian, rank: int, actuators, named: list[int]) -> np.ndarray:
    """Return the dependent columns: not the named joints, and as few of the driven ones as can be.

    Raises:
        ModelError: when the named joints do not fix the others at home.
    """
    driven = [actuator.joint for actuator in actuators if actuator.joint is not None]
    pulled = [
        dof
        for actuator in actuators
        if int(model.actuator_trntype[actuator.index]) == int(TRN_TENDON)
        and is_fixed(model, int(model.actuator_trnid[actuator.index, 0]))
        for dof in tendon_joints(model, int(model.actuator_trnid[actuator.index, 0]))
    ]
    groups, left = [], list(range(len(joints)))
    for group in (named, driven, pulled):
        groups.insert(0, [i for i in dict.fromkeys(group) if i in left])
        left = [i for i in left if i not in groups[0]]
    chosen = dependent_columns(jacobian, rank, [left, *groups])
    if named and (lost := [joints[i].name for i in named if i in chosen]):
        raise ModelError(
            f"mechanism.independent = {[joints[i].name for i in named]} is singular at home: the loops fix joint"
            f" {', '.join(lost)} there whatever the other coordinates do; name another joint, or another home pose"
        )
    if named and rank:
        values = np.linalg.svd(jacobian[:, chosen], compute_uv=False)
        if values[-1] < _SINGULAR_CHOICE * values[0]:
            raise ModelError(
                f"mechanism.independent = {[joints[i].name for i in named]} is singular at home: the other joints are at a"
                " dead centre there; name another joint, or another home pose"
            )
    return chosen
