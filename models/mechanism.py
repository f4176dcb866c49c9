"""A closed-chain mechanism: a MuJoCo model, its joints, closures and actuators, and its reduced dynamics."""

import functools
import hashlib
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator, effort_matrix, lengths, read_actuators
from linkplan.models.actuation.distribution import ZERO_ARM_SHARE
from linkplan.models.closure.closed_home import close_home
from linkplan.models.closure.equations import Closure, gaps_by_unit, read_closures
from linkplan.models.closure.initial_assembly import (
    home_of,
    idle_drives,
)
from linkplan.models.closure.mobility import (
    find_coasting_dofs,
    find_passive_dofs,
    lost_freedoms,
    round_spins,
)
from linkplan.models.closure.newton import ProjectedLoops, projected_loops
from linkplan.models.coordinate_choice import choose_coordinates, refuse_singular_inertia
from linkplan.models.deadline import one_thread_at_a_time
from linkplan.models.digest import compiled_bytes
from linkplan.models.equations import Equations
from linkplan.models.errors import ModelError, choose
from linkplan.models.external_forces import ForcesOverTime
from linkplan.models.foreign.floating import MAX_LOOSE_BODIES, refuse_many_loose
from linkplan.models.kinematics import extent_m, set_softness
from linkplan.models.library import NOTHING_SELECTED, compile_model
from linkplan.models.mechanism_html import mechanism_html
from linkplan.models.parameters import Parameter, is_of_forces, set_parameters, with_symbols, without_values
from linkplan.models.payload import Payload, payload_from
from linkplan.models.reduction.reduced import ReducedDynamics, reduce_tree, with_numbers
from linkplan.models.selection import Selection, home_qpos
from linkplan.models.tree.coordinates import Coordinates
from linkplan.models.tree.dynamics import Tree, build_tree
from linkplan.models.tree.friction import friction_notes, transition_speed
from linkplan.models.tree.joints import BallRange, Joint, index_of, limited_balls, read_joints
from linkplan.models.tree.tendons import TendonRange, limited_tendons


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Mechanism:
    """A mechanism assembled at its home pose.

    The coordinates q (n_q,) are defined in `models.tree.coordinates`; `independent` and `dependent` are indices into q. The
    loops are closed at `home` (n_q,). They were open by `home_gap_m` at the model's own reference pose, before assembly.
    They count as closed below a gap of `closed_m`, which is larger if the file's numbers are rounded. Overconstrained loops
    are in `projected` and are closed by the normal equations of all their rows. `passive_dofs` are independent coordinates
    that move while all other bodies rest, as the spin of a rod between balls does. On `coasting_dofs` only damping acts, as
    on a loose cart. `notes` are about the assembly, `faults` what it loses by a file's rounding; `source` is its table.
    `forces` act on sites over the time of a problem's motion; `dynamics` are those without them, `forced` those with them.

    Example::

        knee = linkplan.load_mechanism("optimus-knee")
        print(knee.dof, [joint.name for joint in knee.independent_joints], knee.effort_limit)  # N.m
    """

    name: str
    model: mujoco.MjModel
    payload: Payload | None
    selection: Selection  # what was taken out of a larger model
    shifted: tuple[int, ...]  # equality constraints whose anchors were moved along their hinge's axis
    joints: tuple[Joint, ...]
    actuators: tuple[Actuator, ...]
    tendons: tuple[TendonRange, ...]  # tendons with a limited length
    balls: tuple[BallRange, ...]  # ball joints with a limited angle
    closures: tuple[Closure, ...]
    closure_rows: np.ndarray  # independent rows of phi
    projected: tuple[ProjectedLoops, ...]
    independent: np.ndarray
    dependent: np.ndarray
    home: np.ndarray
    reference: np.ndarray
    home_gap_m: float
    closed_m: float
    extent_m: float  # the size of the moving bodies
    dynamics: ReducedDynamics
    parameters: tuple[Parameter, ...]  # numbers of the model that stay symbols: the payload's seven, then the named ones
    parametric: ReducedDynamics | None  # with the parameters as further inputs; None without parameters
    friction_transition: float  # transition speed of dry friction, see `models.tree.friction`
    coordinates: Coordinates
    passive_dofs: tuple[int, ...]
    coasting_dofs: tuple[int, ...]
    notes: tuple[str, ...]
    faults: tuple[str, ...]
    source: Mapping[str, Any]
    forces: ForcesOverTime | None = None

    def __reduce__(self) -> tuple:
        with ca.global_pickle_context():  # CasADi expressions need one
            return _unpickled, (pickle.dumps({field.name: getattr(self, field.name) for field in fields(self)}),)

    def __repr__(self) -> str:
        return f"Mechanism({self.name!r}, {self.dof} of {self.n_q} coordinates independent)"

    @property
    def n_q(self) -> int:
        """The number of internal coordinates; a ball joint has three."""
        return len(self.joints)

    @property
    def closure_names(self) -> tuple[str, ...]:
        """The names of the equality constraints that close the loops."""
        return tuple({closure.index: closure.name for closure in self.closures}.values())

    @property
    def n_closure_rows(self) -> int:
        """The number of closure equations, redundant ones included."""
        return self.closures[-1].rows.stop if self.closures else 0

    @property
    def dof(self) -> int:
        """The number of degrees of freedom: n_q less the rank of the closure."""
        return len(self.independent)

    @property
    def n_equations(self) -> int:
        """The number of equations of motion: `dof`, or more where a path guides freedoms without a force."""
        return int(self.dynamics.residual.numel_out(0))

    @property
    def n_u(self) -> int:
        """The number of usable actuators."""
        return len(self.actuators)

    @property
    def independent_joints(self) -> tuple[Joint, ...]:
        """The joints whose positions are the reduced coordinates s."""
        return tuple(self.joints[i] for i in self.independent)

    @property
    def channels(self) -> tuple[int, ...]:
        """The indices of the independent joints that have a feedback loop.

        If the actuators do not move all freedoms one by one, these are the joints on which an actuator acts; the others
        move along.
        """
        held = np.flatnonzero(self.actuated).tolist()
        arms = np.array(self.dynamics.effort_map(self.home))[held]
        if self.n_u >= len(held) and np.linalg.matrix_rank(arms, rtol=ZERO_ARM_SHARE) == len(held):
            return tuple(held)
        column: dict[int | None, int] = {int(index): k for k, index in enumerate(self.independent)}
        found = {
            column.get(actuator.joint, held[int(np.argmax(np.abs(arms[:, k])))]) for k, actuator in enumerate(self.actuators)
        }
        return tuple(sorted(found))

    @property
    def effort_limit(self) -> np.ndarray:
        """The actuators' limits (n_u, 2) [N.m or N]."""
        return np.array([a.effort_ends for a in self.actuators]).reshape(-1, 2)

    @property
    def pre_tension(self) -> np.ndarray:
        """The efforts (n_u,) [N.m or N] nearest to which more actuators than freedoms share an effort; 0 by default."""
        return np.array([self.selection.pre_tension.get(actuator.name, 0.0) for actuator in self.actuators])

    @property
    def actuated(self) -> np.ndarray:
        """A mask (n_s,) of the coordinates that actuators may hold: all but the passive and the coasting ones."""
        return ~np.isin(self.independent, [*self.passive_dofs, *self.coasting_dofs])

    @property
    def cyclic(self) -> np.ndarray:
        """A mask (n_s,) of the freedoms without a drive on which the dynamics do not depend."""
        return round_spins(self.dynamics, self.home, ~self.actuated)

    @property
    def parameter_values(self) -> np.ndarray:
        """The values (n,) [SI] of the parameters."""
        return np.array([one.value for one in self.parameters])

    def fingerprint(self, *, parameters_apart: bool = False) -> str:
        """Return a hash of the compiled model and of the choice of coordinates, which determine the reduced dynamics.

        With `parameters_apart` the hash does not depend on the values of parameters that change forces only.
        """
        return _fingerprint(self, parameters_apart)

    @property
    def forced(self) -> ReducedDynamics:
        """The reduced dynamics whose last inputs are those of `forces_at`; `dynamics` are those without forces over time."""
        return self.dynamics if self.forces is None else _forced(self)

    def forces_at(self, time_s: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the forces over time (n, 3 n_sites) [N] at times (n,), in a tuple; it is empty without forces over time."""
        return () if self.forces is None else (self.forces.curve.derivative(time_s),)

    def parametric_dynamics(self) -> ReducedDynamics:
        """Return the reduced dynamics with the parameters (n,) and the forces over time as every last input.

        Raises:
            ModelError: if there is neither.
        """
        if self.forces is not None:
            return _parametric(self)
        if self.parametric is None:
            raise ModelError(f"mechanism '{self.name}' has no parameters")
        return self.parametric

    def with_parameters(self, values: Mapping[str, float | None]) -> "Mechanism":
        """Return the mechanism with values [SI] of numbers of its model by name, which stay symbols in its equations.

        The names are those of `models.parameters`; None keeps a number's value. The loops are closed again. Parameters that
        the mechanism has already keep their values.

        Raises:
            ModelError: for an unknown name, two names for one number, or a value out of its bounds.
            AssemblyError: if the loops do not close with these values.

        Example::

            longer = linkplan.load_mechanism("optimus-knee").with_parameters({"coupler.length": 0.0742})
        """
        asked, named = self.source, dict(self.source.get("parameters", {}))
        own = {one.name: one.value for one in self.parameters if one.name in named}
        further = {"payload": self.payload, "selection": self.selection, "parameters": own | dict(values)}
        found = load_mechanism(asked["model"], **further, **loading_arguments(asked))
        for name, value in values.items():
            before = named.get(name)  # a table keeps its range and tolerance
            named[name] = {**before, "value": value} if isinstance(before, Mapping) and value is not None else value
        source = {**asked, "parameters": named}
        if isinstance(asked.get("payload"), Mapping) and found.payload is not None:
            source["payload"] = found.payload.table()
        return replace(found, forces=self.forces, source=source)

    def joint_index(self, name: str, error: type[Exception] = ModelError) -> int:
        """Return the index of a joint by name."""
        return index_of(self.name, self.joints, name, error)

    def closure_slice(self, closure: int) -> slice:
        """Return the rows of the force [N] of closure number `closure` in `closure_names`; for a weld those of its point."""
        return next(gap.rows for gap in self.closures if gap.index == self.equalities[closure])

    @property
    def equalities(self) -> tuple[int, ...]:
        """The numbers of the equality constraints in the model, in the order of `closure_names`."""
        return tuple(dict.fromkeys(gap.index for gap in self.closures))

    @property
    def equations(self) -> Equations:
        """The equations of the closed chain, as functions of arrays and as CasADi functions."""
        return Equations(
            dynamics=self.dynamics,
            joints=self.joints,
            home=self.home,
            independent=self.independent,
            extent_m=self.extent_m,
            effort_limit=self.effort_limit,
        )

    def _repr_html_(self) -> str:
        return mechanism_html(self.name, self.dof, self.joints, self.independent, self.actuators, self.closure_names)

    def gap_m(self, q: np.ndarray) -> float:
        """Return the largest gap [m] of any closure at pose q (n_q,); angles are multiplied by the extent."""
        return float(self.gaps_m(np.asarray(q)[None])[0])

    def gaps_m(self, q: np.ndarray) -> np.ndarray:
        """Return the largest gap (n,) [m] of any closure at each of the poses q (n, n_q)."""
        phi = self._closure(q)
        return np.max([np.zeros(len(q)), *(np.linalg.norm(phi[:, one.rows], axis=1) for one in self.closures)], axis=0)

    def gaps_by_unit(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Return the largest gap (n,) of the closures at poses q (n, n_q) by unit, "m" or "rad"."""
        return gaps_by_unit(self.closures, self._closure(q))

    def _closure(self, q: np.ndarray) -> np.ndarray:
        return np.array(self.dynamics.closure.map(len(q))(np.asarray(q, dtype=float).T)).T

    def qpos_of(self, q: np.ndarray) -> np.ndarray:
        """Return MuJoCo's qpos (..., nq) of poses q (..., n_q)."""
        return self.coordinates.qpos_of(q)

    def q_of(self, qpos: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return the poses q (..., n_q) of MuJoCo's qpos (..., nq), with whole turns chosen to be `near` a pose."""
        return self.coordinates.q_of(qpos, near)

    def qvel_of(self, q: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return MuJoCo's qvel (..., nv) of poses and their rates q' (..., n_q)."""
        return self.coordinates.qvel_of(q, rates)

    def rates_of(self, q: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Return the rates q' (..., n_q) of poses q under MuJoCo's qvel (..., nv)."""
        return self.coordinates.rates_of(q, qvel)


def _unpickled(content: bytes) -> Mechanism:
    with ca.global_unpickle_context():
        return Mechanism(**pickle.loads(content))


@functools.lru_cache(maxsize=64)
def _fingerprint(mechanism: Mechanism, parameters_apart: bool) -> str:
    # Pins, axes and gears stand in limits and bounds as constants, too.
    apart = [one for one in mechanism.parameters if is_of_forces(one)] if parameters_apart else []
    digest = hashlib.sha256(compiled_bytes(without_values(mechanism.model, apart)))
    if parameters_apart:
        digest.update(repr([one.name for one in mechanism.parameters]).encode())
    for choice in (mechanism.independent, mechanism.dependent, mechanism.closure_rows):
        digest.update(choice.tobytes() + b"|")
    digest.update(np.float64(mechanism.friction_transition).tobytes())
    if mechanism.forces is not None:  # which are parameters of the dynamics, on these sites
        digest.update(repr(mechanism.forces.sites).encode())
    return digest.hexdigest()


def parametric_tree(mechanism: Mechanism, displacement: ca.SX | None = None) -> tuple[Tree, ca.SX]:
    """Return a mechanism's tree with its parameters and the forces over time as symbols, and these symbols.

    `displacement` is that of `build_tree`.
    """
    model, n = mechanism.model, len(mechanism.parameters)
    sites = () if mechanism.forces is None else [int(model.site(name).id) for name in mechanism.forces.sites]
    given = ca.SX.sym("parameters", n + 3 * len(sites))
    pushes = {site: given[n + 3 * k : n + 3 * k + 3] for k, site in enumerate(sites)}
    varied = with_symbols(model, mechanism.parameters, given[:n]) if n else model
    return build_tree(varied, home_qpos(model), mechanism.friction_transition, pushes, displacement), given


@functools.lru_cache(maxsize=16)
def _parametric(mechanism: Mechanism) -> ReducedDynamics:
    """Return the dynamics of a mechanism with forces over time, with its parameters and the forces as last input."""
    tree, given = parametric_tree(mechanism)
    B, own = effort_matrix(tree.model, tree, mechanism.actuators), lengths(tree.model, tree, mechanism.actuators)
    chosen = mechanism.closure_rows, mechanism.independent, mechanism.dependent
    values = np.append(mechanism.parameter_values, np.zeros(given.numel() - len(mechanism.parameters)))
    return reduce_tree(tree, read_closures(tree.model, tree), B, *chosen, given, values, mechanism.projected, own)


@functools.lru_cache(maxsize=16)
def _forced(mechanism: Mechanism) -> ReducedDynamics:
    """Return the dynamics of a mechanism with forces over time, which are their only parameters."""
    return with_numbers(_parametric(mechanism), mechanism.parameter_values)


def loading_arguments(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `load_mechanism` for the pose and the loops, from the keys of a table [mechanism]."""
    speed = table.get("friction_transition_deg_s")
    return {
        "home": {name: np.radians(angle) for name, angle in table.get("home_deg", {}).items()} | table.get("home_m", {}),
        "friction_transition": None if speed is None else np.radians(speed),
        **{key: table.get(key) for key in ("independent", "solref", "closure_tolerance_m")},
    }


@one_thread_at_a_time
def load_mechanism(
    source: str | Path,
    *,
    payload: Payload | str | Mapping | None = None,
    home: Mapping[str, float] | None = None,
    independent: Sequence[str] | None = None,
    solref: str | None = None,
    closure_tolerance_m: float | None = None,
    friction_transition: float | None = None,
    selection: Selection = NOTHING_SELECTED,
    parameters: Mapping[str, float | None] | None = None,
) -> Mechanism:
    """Return the mechanism of a built-in name, an MJCF file or MJCF text, assembled.

    Args:
        source: a built-in name, a path, or MJCF text.
        payload: a `Payload`, a built-in payload's name, or a table with body, mass_kg, com_m, inertia_kgm2.
        home: joint positions by name [rad or m] at which to assemble. Independent joints keep these positions; the others
            choose the branch. The default guess is the model's keyframe "home", else its reference pose.
        independent: names of the independent joints; by default the actuated joints, as far as the closure allows.
        solref: "stiff" simulates with the stiffest equality constraints that the timestep admits; default: the model's own.
        closure_tolerance_m: the largest gap [m] that counts as rounding of the file; by default 1e-6 m, or 1e-5 of a small
            mechanism's extent.
        friction_transition: speed v_0 of dry friction [rad/s; extents per second on a slide or tendon]; by default 2 deg/s.
        selection: the part of a larger model to use.
        parameters: numbers of the model by name (`models.parameters`) that stay symbols in its equations, with their values
            [SI]; None keeps the model's own value.

    Raises:
        ModelError: if the model cannot be used, or the named joints cannot be its coordinates.
        InertiaError: if some motion of the joints at home has no kinetic energy.
        AssemblyError: if the loops do not close at, or near, the asked pose.
    """
    payload = payload_from(payload)
    name, model, left_out = compile_model(source, payload, selection, changes=bool(parameters))
    varied = set_parameters(model, parameters or {})
    payload = None if payload is None else payload.as_in(model)
    set_softness(model, solref)
    if model.njnt == 0:
        raise ModelError(f"model '{name}' has no joint: there is nothing to move")
    if model.nbody > MAX_LOOSE_BODIES:
        refuse_many_loose(name, model)
    pi = ca.SX.sym("parameters", len(varied)) if varied else None
    transition = transition_speed(friction_transition)
    symbolic = model if pi is None else with_symbols(model, varied, pi)
    moving = any(one.moves_pins for one in varied)
    tree = build_tree(model if moving else symbolic, home_qpos(model), transition)
    joints, actuators, extent = read_joints(name, model, tree.coordinates), read_actuators(model), extent_m(model)
    closed = close_home(name, model, tree, joints, extent, home=home, tolerance_m=closure_tolerance_m)
    loop, mobility, pose, about = closed.mobility.loop, closed.mobility, closed.pose, closed.about
    jacobians = [loop.jacobian(q) for q in (pose, *about)]
    rows, free, dependent = choose_coordinates(loop, model, actuators, jacobians, independent)
    closed.refuse_singular(free)
    B = effort_matrix(symbolic, tree, actuators)
    noise = 1e4 * mobility.noise  # rounding of the file affects J more away from home than at home
    projected = projected_loops(loop, rows.tolist(), dependent.tolist(), pose, noise, inexact=bool(mobility.freed_m))
    closures = loop.closures
    if moving:
        tree = build_tree(symbolic, home_qpos(model), transition)
        closures, B = read_closures(symbolic, tree), effort_matrix(symbolic, tree, actuators)
    own = lengths(symbolic, tree, actuators)
    values = np.array([one.value for one in varied])
    parametric = reduce_tree(tree, closures, B, rows, free, dependent, pi, values, projected, own)
    dynamics = with_numbers(parametric, values) if varied else parametric
    refuse_singular_inertia(name, joints, free, dynamics, pose)
    poses = [q for q in (pose, *about) if loop.rank(q) == len(dependent)]
    passive, notes = find_passive_dofs(model, joints, tree.coordinates, dynamics, free, poses, extent)
    notes += lost_freedoms(joints, dynamics, poses, mobility, closed.tolerance_m)
    idle, faults = idle_drives(joints, actuators, dynamics, poses, mobility, extent)
    notes = [*left_out, *(shift.sentence for shift in closed.moved), *notes, *idle]
    notes += [*friction_notes(model, transition, extent), *closed.reference_notes(len(dependent))]
    asked = {
        "payload": None if payload is None else payload.table(),
        **home_of([joints[i] for i in closed.held], list(closed.held.values())),
        **selection.table(),
        "independent": None if independent is None else list(independent),
        "closure_tolerance_m": closure_tolerance_m,
        "solref": solref,
        "friction_transition_deg_s": None if friction_transition is None else float(np.degrees(transition)),
        "parameters": dict(parameters) if parameters else None,
    }
    mechanism = Mechanism(
        name=name,
        model=model,
        payload=payload,
        selection=selection,
        shifted=tuple(shift.index for shift in closed.moved),
        joints=joints,
        actuators=actuators,
        tendons=limited_tendons(model),
        balls=limited_balls(model),
        closures=loop.closures,
        closure_rows=rows,
        projected=projected,
        independent=free,
        dependent=dependent,
        home=pose,
        reference=closed.reference,
        home_gap_m=loop.gap(loop.residual(closed.reference)[0]),
        closed_m=loop.closed_m,
        extent_m=extent,
        dynamics=dynamics,
        parameters=varied,
        parametric=parametric if varied else None,
        friction_transition=transition,
        coordinates=tree.coordinates,
        passive_dofs=passive,
        coasting_dofs=find_coasting_dofs(dynamics, free, passive, poses),
        notes=tuple(notes),
        faults=tuple(faults),
        source={"model": str(source)} | {key: value for key, value in asked.items() if value is not None},
    )
    for actuator in selection.pre_tension:
        choose("actuator in mechanism.pre_tension", actuator, [one.name for one in actuators])
    for array in (mechanism.home, mechanism.reference, rows, free, dependent):
        array.flags.writeable = False
    return mechanism
