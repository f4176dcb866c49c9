"""Rates, accelerations and multipliers of dependent joints as unknowns of their own, where their elimination is long.

Reduced dynamics solve with J_z, the closure's derivative by the dependent joints, in symbols. Where loops are not closed one
after another, as under a platform on six legs, J_z is one block: of 15 joints it makes 3.4 million operations of a node's
second derivatives. Lifted (Albersmeyer & Diehl, SIAM J. Optim. 20, 2010), the same equations are

    phi(q) = 0,   J q' = 0,   J q'' + J' q' = 0,   M q'' + h - B u - J^T mu = 0,

in which nothing is solved: 3 n_z unknowns and rows more, and expressions as short as the tree's. The motions are the same.
"""

import functools

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism

# Operations of Gamma, the solution with J_z, beyond which a program is lifted. Andrews' squeezer has 322 and is not. Seconds
# of processor time for a plan before and lifted, objectives the same: a wishbone (1,418) 12.7 and 8.9, a delta robot (1,544)
# 3.0 and 1.8, in least time 5.2 and 2.8, a platform on six rods (14,931) 51 and 9.
_LONG = 1_000


@functools.lru_cache(maxsize=16)
def is_lifted(mechanism: Mechanism) -> bool:
    """Return whether a mechanism's program is lifted."""
    return not mechanism.dynamics.projected and mechanism.dynamics.velocity_map.n_instructions() > _LONG


def n_lifted(mechanism: Mechanism) -> int:
    """Return the number of unknowns beyond the dependent joints' positions: their rates, accelerations, and multipliers."""
    return 3 * len(mechanism.dependent) if is_lifted(mechanism) else 0


def in_order(mechanism: Mechanism, independent: ca.SX, dependent: ca.SX) -> ca.SX:
    """Return values of all joints (n_q,) from those of the independent and of the dependent ones."""
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent]))
    return ca.vertcat(independent, dependent)[[int(i) for i in order]]


def lifted_rows(
    mechanism: Mechanism, unknowns: ca.SX, call, given: dict[str, ca.SX], motion: tuple[ca.SX, ca.SX, ca.SX, ca.SX]
) -> tuple[ca.SX, tuple[str, ...], ca.SX]:
    """Return a node's rows beside phi, what they are, and the rates (n_q,) of all joints.

    Args:
        mechanism: the mechanism.
        unknowns: (3 n_z,) rates and accelerations of dependent joints and multipliers, scaled.
        call: the reduced dynamics' functions by name.
        given: the node's parameters.
        motion: q (n_q,), v, a (n_s,) and u (n_u,) in SI.
    """
    q, v, a, u = motion
    rates, accelerations, multipliers = ca.vertsplit(unknowns, len(mechanism.dependent))
    rates = in_order(mechanism, v, rates / given["time"])
    accelerations = in_order(mechanism, a, accelerations / given["time"] ** 2)
    opening, turning, held = _closure(mechanism)(q, rates, accelerations, multipliers * given["force"])
    left = call("tree_effort", q, rates, accelerations) - call("effort_matrix", q) @ u - held
    unit = ca.mmax(given["residual"])
    slides = np.array([mechanism.joints[int(i)].kind == "slide" for i in mechanism.dependent])
    units = ca.vertcat(*[unit / given["length"] if slide else unit for slide in slides])
    units = in_order(mechanism, ca.vertcat(*[unit] * len(mechanism.independent)), units)
    opening, turning = opening * given["time"] / given["length"], turning * given["time"] ** 2 / given["length"]
    kinds = ("closure",) * opening.numel() + ("acceleration",) * turning.numel() + ("dynamics",) * left.numel()
    return ca.vertcat(opening, turning, left / units), kinds, rates


@functools.lru_cache(maxsize=16)
def _closure(mechanism: Mechanism) -> ca.Function:
    """Return (q, q', q'', mu) -> J q', J q'' + J' q' and J^T mu, of the independent closure equations."""
    q, rates, accelerations = (ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd"))
    phi = mechanism.dynamics.independent_closure(q)
    mu = ca.SX.sym("mu", phi.numel())
    opening = ca.jtimes(phi, q, rates)
    turning = ca.jtimes(phi, q, accelerations) + ca.jtimes(opening, q, rates)
    outputs = [ca.densify(part) for part in (opening, turning, ca.jtimes(phi, q, mu, True))]
    return ca.Function("closure", [q, rates, accelerations, mu], outputs)


def lifted_start(
    mechanism: Mechanism, poses: np.ndarray, v: np.ndarray, a: np.ndarray, effort: np.ndarray, time_s: float, force: float
) -> np.ndarray:
    """Return the unknowns (n, 3 n_z) along poses (n, n_q) with v, a (n, n_s) and efforts (n, n_u), scaled."""
    dynamics, dependent, found = mechanism.dynamics, mechanism.dependent, []
    rows = dynamics.independent_closure.numel_out(0)
    for pose, speed, acceleration, u in zip(poses, v, a, effort, strict=True):
        gamma = np.array(dynamics.velocity_map(pose))
        rates, still = gamma @ speed, gamma @ acceleration
        turning = np.array(_closure(mechanism)(pose, rates, still, np.zeros(rows))[1]).ravel()
        J = _jacobian(mechanism)(pose).full()
        still[dependent] -= np.linalg.lstsq(J[:, dependent], turning, rcond=None)[0]
        left = np.array(dynamics.tree_effort(pose, rates, still) - dynamics.effort_matrix(pose) @ u).ravel()
        mu = np.linalg.lstsq(J[:, dependent].T, left[dependent], rcond=None)[0]
        found.append(np.concatenate([rates[dependent] * time_s, still[dependent] * time_s**2, mu / force]))
    return np.array(found)


@functools.lru_cache(maxsize=16)
def _jacobian(mechanism: Mechanism) -> ca.Function:
    q = ca.SX.sym("q", mechanism.n_q)
    return ca.Function("jacobian", [q], [ca.densify(ca.jacobian(mechanism.dynamics.independent_closure(q), q))])
