"""A mechanism whose site is guided along a curve: its only freedom is the parameter x of the curve.

The site's place p(q) = gamma(x) is one more closure, over the joints and one further coordinate x without mass. It fixes how
the joints move. Unlike a loop's pin it gives no force: the drives alone keep the site on the curve. The equations of motion
are therefore all those of the free mechanism, M_r(q) a + b_r(q, v) = Gamma^T B u, with the velocities v = G(q) x' and
accelerations a = G x'' + G' x' of its independent joints; a projection on x would lose the forces across the curve. For
least time this is the path parameterisation of Bobrow, Dubowsky & Gibson (Int. J. Robotics Research 4(3), 1985).
"""

import hashlib
from dataclasses import dataclass, fields, replace

import casadi as ca
import numpy as np

from linkplan.models.actuation.actuators import effort_matrix, lengths
from linkplan.models.closure.equations import Closure, read_closures
from linkplan.models.closure.rank import numerical_rank
from linkplan.models.errors import ModelError
from linkplan.models.guide.curve import Curve
from linkplan.models.mechanism import Mechanism
from linkplan.models.reduction.reduced import ReducedDynamics, reduce_tree
from linkplan.models.selection import home_qpos
from linkplan.models.tree.dynamics import Tree, build_tree
from linkplan.models.tree.joints import Joint

# The curve determines every freedom if the singular values of the site's Jacobian are above this share of the largest.
_RANK_SHARE = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class GuidedDynamics(ReducedDynamics):
    """Reduced dynamics over the curve's parameter, with the equations of all freedoms (n_rows) of the free mechanism.

    `inverse_dynamics`, `residual` and `sliding` have n_rows rows and `effort_map` is (n_rows, n_u). The equations of motion
    in `equations` are the free mechanism's, whose multipliers include no force of the curve. `projection` maps q to G
    (n_rows, 1).
    """

    projection: ca.Function

    def along_freedoms(self, q: ca.SX, efforts: ca.SX) -> ca.SX:
        """Return efforts (1, k) along the curve, of those in all equations (n_rows, k)."""
        return self.projection(q).T @ efforts


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class GuidedMechanism(Mechanism):
    """A mechanism guided along a curve; its last joint is the curve's parameter, a slide [m]."""

    free: Mechanism
    curve: Curve

    def fingerprint(self, *, parameters_apart: bool = False) -> str:
        """Return a hash of the mechanism and the curve."""
        digest = hashlib.sha256(self.free.fingerprint(parameters_apart=parameters_apart).encode())
        for piece in self.curve.pieces:
            for field in fields(piece):
                digest.update(np.asarray(getattr(piece, field.name)).tobytes())
        return digest.hexdigest()


def guided(free: Mechanism, site: int, curve: Curve, pose: np.ndarray) -> GuidedMechanism:
    """Return a mechanism with a site guided along a curve.

    Args:
        free: the mechanism.
        site: the site's index in the model.
        curve: the curve.
        pose: the home pose: a closed pose (n_q,) with the site at the beginning of the curve.

    Raises:
        ModelError: if the curve leaves the mechanism further freedoms, or if the drives do not move all of them.
    """
    import scipy

    name = free.model.site(site).name
    jacobian = _site_jacobian(free, site)(pose).full()
    rank = numerical_rank(jacobian, _RANK_SHARE)
    if rank < free.dof:
        raise ModelError(
            f"a path of site {name} does not determine {free.dof - rank} of the {free.dof} degrees of freedom of"
            f" '{free.name}', and it must determine all of them (mechanism.lock holds joints; limits.site has tubes)"
        )
    moved = int(np.linalg.matrix_rank(np.array(free.dynamics.effort_map(pose))))
    if moved < free.dof:
        raise ModelError(
            f"a path needs drives for all {free.dof} degrees of freedom of '{free.name}', got {free.n_u} drives that move"
            f" {moved} of them"
        )
    rows = np.sort(scipy.linalg.qr(jacobian.T, mode="r", pivoting=True)[1][: free.dof])
    tree, x = _with_parameter(build_tree(free.model, home_qpos(free.model), transition=free.friction_transition))
    closures = read_closures(free.model, tree)
    after = free.n_closure_rows
    gap = Closure(
        name=f"the path of {name}",
        kind="guide",
        index=free.model.neq,
        rows=slice(after, after + 3),
        residual=tree.site(site) - curve.place(x),
        frame=0,
        scale=1.0,
        unit="m",
        per_unit=1.0,
    )
    every = (*closures, gap)
    B = effort_matrix(free.model, tree, free.actuators)
    joints = (*free.joints, Joint(name=f"path of {name}", kind="slide", lower=-np.inf, upper=np.inf))
    independent, dependent = np.array([free.n_q]), np.arange(free.n_q)
    closure_rows = np.concatenate([free.closure_rows, after + rows]).astype(int)
    own = lengths(free.model, tree, free.actuators)
    chosen = closure_rows, independent, dependent
    reduced = reduce_tree(tree, every, B, *chosen, projected=free.projected, lengths=own)
    home = np.append(pose, 0.0)
    own = {field.name: getattr(free, field.name) for field in fields(Mechanism)}
    own |= {
        "joints": joints,
        "closures": every,
        "closure_rows": closure_rows,
        "independent": independent,
        "dependent": dependent,
        "home": home,
        "reference": home,
        "dynamics": _with_all_rows(reduced, free),
        "parameters": (),
        "parametric": None,
        "payload": None,
        "passive_dofs": (),
        "coasting_dofs": (),
    }
    return GuidedMechanism(**own, free=free, curve=curve)


def _site_jacobian(free: Mechanism, site: int) -> ca.Function:
    q = ca.SX.sym("q", free.n_q)
    place = free.dynamics.site_places(q)[:, site]
    return ca.Function("J", [q], [ca.densify(ca.jacobian(place, q) @ free.dynamics.velocity_map(q))])


def _with_parameter(tree: Tree) -> tuple[Tree, ca.SX]:
    """Return a tree with one further coordinate without mass or force, and its symbol."""
    x, rate, acceleration = ca.SX.sym("x"), ca.SX.sym("xd"), ca.SX.sym("xdd")
    longer = {
        name: ca.vertcat(getattr(tree, name), ca.SX(1, 1))
        for name in ("inverse_dynamics", "bias", "gravity", "passive", "friction")
    }
    longer["mass_matrix"] = ca.diagcat(tree.mass_matrix, ca.SX(1, 1))
    longer["velocity_matrix"] = ca.diagcat(tree.velocity_matrix, ca.SX.eye(1))
    symbols = {"q": ca.vertcat(tree.q, x), "qd": ca.vertcat(tree.qd, rate), "qdd": ca.vertcat(tree.qdd, acceleration)}
    return replace(tree, **symbols, **longer), x


def _with_all_rows(reduced: ReducedDynamics, free: Mechanism) -> GuidedDynamics:
    """Return the dynamics of the curve's parameter with the equations of the free mechanism."""
    n_q, independent = free.n_q, [int(i) for i in free.independent]
    q, v, a, u = (ca.SX.sym(name, n) for name, n in (("q", n_q + 1), ("v", 1), ("a", 1), ("u", free.n_u)))
    gamma = reduced.velocity_map(q)
    rates = gamma @ v
    joints = gamma @ a + ca.jtimes(rates, q, rates)
    motion = q[:n_q], rates[independent], joints[independent]
    needed, given = free.dynamics.inverse_dynamics(*motion), free.dynamics.effort_map(q[:n_q])
    sliding = free.dynamics.sliding(*motion, u)
    rate, acceleration = ca.SX.sym("qd", n_q + 1), ca.SX.sym("qdd", n_q + 1)
    mu = ca.SX.sym("mu", len(free.closure_rows))
    closing = reduced.equations(q, rate, acceleration, ca.SX(len(reduced.dependent), 1), u)[:3]
    of_free = free.dynamics.equations(q[:n_q], rate[:n_q], acceleration[:n_q], mu, u)[3:]

    def function(name: str, inputs: list[ca.SX], *outputs: ca.SX) -> ca.Function:
        names, results = [f"i{k}" for k in range(len(inputs))], [f"o{k}" for k in range(len(outputs))]
        return ca.Function(name, inputs, [ca.densify(output) for output in outputs], names, results)

    own = {field.name: getattr(reduced, field.name) for field in fields(ReducedDynamics)}
    own |= {
        "inverse_dynamics": function("inverse_dynamics", [q, v, a], needed),
        "residual": function("residual", [q, v, a, u], needed - given @ u),
        "sliding": function("sliding", [q, v, a, u], sliding),
        "equations": function("equations", [q, rate, acceleration, mu, u], *closing, *of_free),
        "effort_map": function("effort_map", [q], given),
        "projection": function("projection", [q], gamma[independent, :]),
    }
    return GuidedDynamics(**own)
