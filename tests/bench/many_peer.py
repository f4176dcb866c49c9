"""What a careful user writes by hand for robots of several motors: collocation in `casadi.Opti`, without a certificate.

Radau collocation of degree 3 on 40 even intervals. Positions and speeds of the independent joints are states; accelerations,
efforts and dependent joints are unknowns at the nodes, tied by inverse dynamics and closure. The dynamics are linkplan's own
expressions, which a user of Pinocchio or CasADi would have too. If their elimination of dependent joints is long, rates,
accelerations and multipliers of the tree are unknowns instead, as in linkplan.

Used well: the node is one SX function, mapped over the nodes; all unknowns are scaled by limits and the motion's span and
duration; limits on single unknowns are bounds; the start is linkplan's smooth path with the efforts and the duration that it
needs. Efforts keep their limits at the nodes only.
"""

import json
import sys
import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.planner.closed_chain.guess import first_guess, poses_along
from linkplan.planner.closed_chain.mechanics import in_order, is_lifted
from linkplan.planner.problem.problem import Problem, load_problem
from tests.bench.opti_peer import IPOPT

INTERVALS, DEGREE = 40, 3
# Of the efforts in the objective of a least time, as a share of full efforts all the time: it decides what those motors do
# that have time to spare, and costs a least time less than a thousandth.
_TIE = 1e-4


def node_function(mechanism: Mechanism) -> ca.Function:
    """Return s, v, a, u, z -> the equations of a node, in SI; z are the dependent joints and what is lifted."""
    n_s, n_z, dynamics = mechanism.dof, len(mechanism.dependent), mechanism.dynamics
    s, v, a, u = (ca.SX.sym(name, size) for name, size in (("s", n_s), ("v", n_s), ("a", n_s), ("u", mechanism.n_u)))
    if not is_lifted(mechanism):
        z = ca.SX.sym("z", n_z)
        q = in_order(mechanism, s, z)
        rows = ca.vertcat(dynamics.independent_closure(q), dynamics.residual(q, v, a, u))
        return ca.Function("node", [s, v, a, u, z], [ca.densify(rows)])
    z = ca.SX.sym("z", 4 * n_z)
    joints, speeds, rates, multipliers = ca.vertsplit(z, n_z)
    q, qd, qdd = (in_order(mechanism, *pair) for pair in ((s, joints), (v, speeds), (a, rates)))
    phi, held = _closure(mechanism)(q, qd, qdd, multipliers)
    left = dynamics.tree_effort(q, qd, qdd) - dynamics.effort_matrix(q) @ u - held
    return ca.Function("node", [s, v, a, u, z], [ca.densify(ca.vertcat(phi, left))])


def _closure(mechanism: Mechanism) -> ca.Function:
    """Return q, q', q'', mu -> the closure with its two derivatives, and J^T mu."""
    q, qd, qdd = (ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd"))
    phi = mechanism.dynamics.independent_closure(q)
    mu = ca.SX.sym("mu", phi.numel())
    opening = ca.jtimes(phi, q, qd)
    turning = ca.jtimes(phi, q, qdd) + ca.jtimes(opening, q, qd)
    return ca.Function("closure", [q, qd, qdd, mu], [ca.vertcat(phi, opening, turning), ca.jtimes(phi, q, mu, True)])


@dataclass(frozen=True, eq=False, slots=True)
class ManyPeer:
    """A built program with its duration [s], the objective in SI and the efforts at its nodes."""

    opti: ca.Opti
    duration: ca.MX
    objective: ca.MX
    effort: ca.MX


def build_many_peer(problem: Problem, options: dict | None = None) -> ManyPeer:
    """Return the program of a reach: least time, least effort, or a mixture of both."""
    mechanism, motion, limits = problem.mechanism, problem.motion, problem.limits
    n_s, n_u, n_z = mechanism.dof, mechanism.n_u, len(mechanism.dependent)
    guess = first_guess(problem, problem.start_pose())
    points = np.array(ca.collocation_points(DEGREE, "radau"))
    D, _, weights = ca.collocation_coeff(list(points))
    breaks = np.linspace(0.0, 1.0, INTERVALS + 1)
    shares = (breaks[:-1, None] + points / INTERVALS).ravel()
    times = guess.duration_s * np.concatenate([[0.0], shares])
    poses = poses_along(mechanism, guess, times)
    s0, v0, a0 = (guess.position(times).T, guess.velocity(times).T, guess.acceleration(times).T)
    u0 = needed_effort(mechanism, poses, v0.T, a0.T)[0].T

    opti = ca.Opti()
    time_unit, effort_unit = guess.duration_s, np.abs(limits.effort).max(axis=1)
    span = np.maximum(np.ptp(s0, axis=1), 0.05)
    units = (span, span / time_unit, span / time_unit**2, effort_unit)
    S, V, A, U = (opti.variable(len(unit), times.size - late) for unit, late in zip(units, (0, 0, 1, 1), strict=True))
    s, v, a, u = (ca.diag(unit) @ X for unit, X in zip(units, (S, V, A, U), strict=True))
    for X, unit, start in zip((S, V, A, U), units, (s0, v0, a0[:, 1:], u0[:, 1:]), strict=True):
        opti.set_initial(X, start / unit[:, None])
    free = motion.duration_s is None
    stretch = opti.variable() if free else ca.MX(motion.duration_s / time_unit)
    T = stretch * time_unit
    if free:
        opti.subject_to(opti.bounded(0.05, stretch, 20.0))
        opti.set_initial(stretch, 1.0)

    for X, slope, unit in ((S, v[:, 1:], span), (V, a, span / time_unit)):
        ends = [X[:, k::DEGREE][:, :INTERVALS] for k in range(DEGREE + 1)]
        rates = [sum(D[i, k] * ends[i] for i in range(DEGREE + 1)) for k in range(DEGREE)]
        for k in range(DEGREE):
            opti.subject_to(rates[k] == T / INTERVALS * (ca.diag(1 / unit) @ slope[:, k::DEGREE]))

    node, dependent = node_function(mechanism), poses[1:, mechanism.dependent].T
    if n_z:
        lifted = is_lifted(mechanism)
        z_units = np.ones(n_z)
        if lifted:
            lever = effort_unit.max() / mechanism.extent_m
            z_units = np.concatenate([z_units, z_units / time_unit, z_units / time_unit**2, np.full(n_z, lever)])
        Z = opti.variable(len(z_units), times.size - 1)
        opti.set_initial(Z[:n_z, :], dependent)
        if lifted:
            opti.set_initial(Z[n_z:, :], _lifted_start(mechanism, node, poses, v0, a0, u0) / z_units[n_z:, None])
        z = ca.diag(z_units) @ Z
    else:
        Z = z = ca.MX(0, times.size - 1)
    row_units = np.concatenate([np.ones(n_z), np.full(n_s, effort_unit.max())])
    if n_z and is_lifted(mechanism):
        row_units = np.concatenate(
            [np.ones(n_z), np.full(n_z, 1 / time_unit), np.full(n_z, 1 / time_unit**2), np.full(mechanism.n_q, effort_unit.max())]
        )
    opti.subject_to(ca.diag(1 / row_units) @ node.map(times.size - 1)(s[:, 1:], v[:, 1:], a, u, z) == 0)

    for X, bounds, unit in (
        (S, limits.position[mechanism.independent], span),
        (V, limits.speed[mechanism.independent], span / time_unit),
        (U, limits.effort, effort_unit),
        *(((Z[:n_z, :], limits.position[mechanism.dependent], np.ones(n_z)),) if n_z else ()),
    ):
        for row in np.flatnonzero(np.isfinite(bounds).any(axis=1)):
            low, high = bounds[row] / unit[row]
            opti.subject_to(opti.bounded(low, X[int(row), :], high))
    for X, column, value in ((S, 0, motion.start), (S, -1, motion.goal), (V, 0, 0 * motion.start), (V, -1, 0 * motion.start)):
        opti.subject_to(X[:, column] == value / (span if X is S else 1))

    squares = ca.sum1((ca.diag(1 / effort_unit) @ u) ** 2 * ca.DM(effort_unit**2))
    effort = T / INTERVALS * sum(float(weights[k]) * ca.sum2(squares[:, k::DEGREE]) for k in range(DEGREE))
    wanted = problem.objective.weights
    objective = wanted.get("time", 0.0) * T + wanted.get("effort", 0.0) * effort
    full = float(np.sum(effort_unit**2))
    if set(wanted) == {"time"}:
        opti.minimize(stretch + _TIE * effort / full / time_unit)
    elif set(wanted) == {"effort"}:
        opti.minimize(effort / full / motion.duration_s)
    else:
        opti.minimize(objective / time_unit)
    opti.solver("ipopt", IPOPT | {"detect_simple_bounds": True} | (options or {}))
    return ManyPeer(opti, T, objective, u)


def _lifted_start(mechanism, node: ca.Function, poses, v, a, u) -> np.ndarray:
    """Return rates, accelerations and multipliers (3 n_z, n_nodes - 1) that satisfy a node's linear equations best."""
    n_z, dependent = len(mechanism.dependent), mechanism.dependent
    found = []
    for pose, speed, acceleration, effort in zip(poses[1:], v.T[1:], a.T[1:], u.T[1:], strict=True):
        z = np.zeros(4 * n_z)
        z[:n_z] = pose[dependent]
        s = pose[mechanism.independent]
        z[n_z : 2 * n_z] = (np.array(mechanism.dynamics.velocity_map(pose)) @ speed)[dependent]
        here = np.array(node(s, speed, acceleration, effort, z)).ravel()
        rest = np.arange(2 * n_z, 4 * n_z)
        slopes = [np.array(node(s, speed, acceleration, effort, z + np.eye(4 * n_z)[k])).ravel() - here for k in rest]
        z[rest] = -np.linalg.lstsq(np.array(slopes).T, here, rcond=None)[0]
        found.append(z[n_z:])
    return np.array(found).T


def main(path: str) -> int:
    """Plan a problem file by the peer and print its answer as JSON; 1 if IPOPT finds none."""
    begin = time.process_time()
    peer = build_many_peer(load_problem(path))
    try:
        solution = peer.opti.solve()
    except RuntimeError:
        print(json.dumps({"status": peer.opti.stats()["return_status"], "objective": None}))
        return 1
    answer = {"status": "solved", "objective": float(solution.value(peer.objective))}
    answer |= {"duration_s": float(solution.value(peer.duration)), "iterations": int(solution.stats()["iter_count"])}
    print(json.dumps(answer | {"processor_s": time.process_time() - begin}))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
