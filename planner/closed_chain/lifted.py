"""Rates, accelerations and multipliers of dependent joints as unknowns, where eliminating them gives long expressions.

Reduced dynamics solve symbolically with J_z, the closure's derivative by the dependent joints. If the loops cannot be closed
one after another, as under a platform on six legs, J_z is one block: with 15 joints a node's second derivatives have 3.4
million operations. In lifted form (Albersmeyer & Diehl, SIAM J. Optim. 20, 2010), the same equations are

    phi(q) = 0,   J q' = 0,   J q'' + J' q' = 0,   M q'' + h - B u - J^T mu = 0.

Nothing is solved symbolically: there are 3 n_z more unknowns and rows, and the expressions are as short as those of the
tree. The motions are the same.
"""

import functools

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism

# Operations of Gamma (the solution with J_z) above which a program is lifted. Andrews' squeezer has 322 and is not.
# Processor time [s] of a plan without and with lifting, at equal objectives: a wishbone (1,418 operations) 12.7 and 8.9, a
# delta robot (1,544) 3.0 and 1.8, in least time 5.2 and 2.8, a platform on six rods (14,931) 51 and 9.
_MAX_ELIMINATION_OPERATIONS = 1_000


@functools.lru_cache(maxsize=16)
def is_lifted(mechanism: Mechanism) -> bool:
    """Check if a mechanism's program is lifted."""
    return (
        not mechanism.dynamics.projected and mechanism.dynamics.velocity_map.n_instructions() > _MAX_ELIMINATION_OPERATIONS
    )


def n_lifted(mechanism: Mechanism) -> int:
    """Return the number of lifted unknowns: rates and accelerations of dependent joints, and multipliers."""
    return 3 * len(mechanism.dependent) if is_lifted(mechanism) else 0


def in_order(mechanism: Mechanism, independent: ca.SX, dependent: ca.SX) -> ca.SX:
    """Return the values of all joints (n_q,) from those of the independent and the dependent joints."""
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent]))
    return ca.vertcat(independent, dependent)[[int(i) for i in order]]


def lifted_rows(
    mechanism: Mechanism, unknowns: ca.SX, call, given: dict[str, ca.SX], motion: tuple[ca.SX, ca.SX, ca.SX, ca.SX]
) -> tuple[ca.SX, tuple[str, ...], ca.SX]:
    """Return a node's rows other than phi, their kinds, and the rates (n_q,) of all joints.

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
    """Return the scaled unknowns (n, 3 n_z) along poses (n, n_q) with v, a (n, n_s) and efforts (n, n_u)."""
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
