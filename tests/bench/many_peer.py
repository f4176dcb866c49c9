"""What a careful user writes by hand for robots of several motors: collocation in `casadi.Opti`, without a certificate.

Radau collocation of degree 3 on 40 even intervals. Positions and speeds of the independent joints are states. Accelerations
and efforts are unknowns at the nodes, tied by inverse dynamics, whose expressions are linkplan's. In a closed chain the
positions, rates and accelerations of the other joints and the multipliers are unknowns too, as they would be by hand.
Nothing is divided by the closure's determinants, which vanish at a singular pose, and a row for each keeps its sign.

Used well: a node is one SX function, mapped over the nodes. Unknowns are scaled by limits, span and duration. Limits on
single unknowns are bounds. The start is linkplan's smooth path with the duration and the efforts that it needs, and IPOPT
begins with a small barrier there. Limits hold at the nodes only.
"""

import json
import sys
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.planner.closed_chain.guess import first_guess, poses_along
from linkplan.planner.closed_chain.mechanics import in_order
from linkplan.planner.problem.problem import Problem, load_problem
from tests.bench.opti_peer import IPOPT

INTERVALS, DEGREE = 40, 3
# Of the effort in the objective of a least time, as a share of full effort all the time: it settles what motors do that have
# time to spare, and costs a ten-thousandth of the least time at most.
_TIE = 1e-4
# Of the determinants of the closure's blocks, the least share of their values at the start.
_REGULAR = 0.02
# The quickest of barriers 1e-1, 1e-2 and 1e-3 on legs and arms, and the most iterations and processor time [s].
_SOLVER = IPOPT | {"detect_simple_bounds": True, "ipopt.mu_init": 1e-2, "ipopt.max_iter": 500, "ipopt.max_cpu_time": 120.0}


@dataclass(frozen=True, eq=False, slots=True)
class ManyPeer:
    """A built program with its duration [s], objective in SI, and the efforts (n_u, n_nodes) [N.m or N] at its nodes."""

    opti: ca.Opti
    duration: ca.MX
    objective: ca.MX
    effort: ca.MX


def node_function(mechanism: Mechanism) -> ca.Function:
    """Return s, v, a, u, z -> a node's equations in SI, and determinants; z (4 n_z,) are the dependent joints' unknowns."""
    n_s, n_z, n_q, dynamics = mechanism.dof, len(mechanism.dependent), mechanism.n_q, mechanism.dynamics
    s, v, a, u = (ca.SX.sym(name, size) for name, size in (("s", n_s), ("v", n_s), ("a", n_s), ("u", mechanism.n_u)))
    z = ca.SX.sym("z", 4 * n_z)
    of = [z[k * n_z : (k + 1) * n_z] for k in range(4)]
    q, qd, qdd = (ca.SX.sym(name, n_q) for name in ("q", "qd", "qdd"))
    phi = dynamics.independent_closure(q)
    opening = ca.jtimes(phi, q, qd)
    turning = ca.jtimes(phi, q, qdd) + ca.jtimes(opening, q, qd)
    mu = ca.SX.sym("mu", n_z)
    left = dynamics.tree_effort(q, qd, qdd) - dynamics.effort_matrix(q) @ u
    left -= ca.jtimes(phi, q, mu, True) if n_z else 0
    rows, dets = ca.vertcat(phi, opening, turning, left), dynamics.block_singularity(q)
    at = ca.Function("at", [q, qd, qdd, u, mu], [ca.densify(rows), dets])
    places = [in_order(mechanism, *pair) for pair in ((s, of[0]), (v, of[1]), (a, of[2]))]
    return ca.Function("node", [s, v, a, u, z], at(*places, u, of[3]))


def build_many_peer(problem: Problem) -> ManyPeer:
    """Return the program of a reach: least time, least effort, or a mixture of both."""
    mechanism, motion, limits = problem.mechanism, problem.motion, problem.limits
    guess = first_guess(problem, problem.start_pose())
    points = np.array(ca.collocation_points(DEGREE, "radau"))
    times = np.concatenate([[0.0], (np.arange(INTERVALS)[:, None] + points).ravel()]) * guess.duration_s / INTERVALS
    poses = poses_along(mechanism, guess, times)
    s, v, a = (of(times) for of in (guess.position, guess.velocity, guess.acceleration))
    u, unit_s, full = needed_effort(mechanism, poses, v, a)[0], guess.duration_s, np.abs(limits.effort).max(axis=1)
    span = np.maximum(np.ptp(s, axis=0), 0.05)

    opti = ca.Opti()

    def unknowns(start: np.ndarray, unit: np.ndarray, bounds: np.ndarray | None = None) -> tuple[ca.MX, ca.MX]:
        """Return scaled unknowns and the same in SI, for starts (n_nodes, n), units (n,) and bounds (n, 2)."""
        scaled = opti.variable(*start.T.shape)
        opti.set_initial(scaled, start.T / unit[:, None])
        for row in [] if bounds is None else np.flatnonzero(np.isfinite(bounds).any(axis=1)):
            opti.subject_to(opti.bounded(bounds[row, 0] / unit[row], scaled[int(row), :], bounds[row, 1] / unit[row]))
        return scaled, ca.diag(unit) @ scaled

    free, joints = motion.duration_s is None, mechanism.independent
    stretch = opti.variable() if free else 1.0
    if free:
        opti.subject_to(opti.bounded(0.05, stretch, 20.0))
        opti.set_initial(stretch, 1.0)
    T = ca.MX(stretch * unit_s)
    S, in_s = unknowns(s, span, limits.position[joints])
    V, in_v = unknowns(v, span / unit_s, limits.speed[joints])
    _, in_a = unknowns(a[1:], span / unit_s**2)
    _, in_u = unknowns(u[1:], full, limits.effort)
    _collocate(opti, S, in_v[:, 1:] * T / INTERVALS, span)
    _collocate(opti, V, in_a * T / INTERVALS, span / unit_s)
    for X, column, value in ((S, 0, motion.start / span), (S, -1, motion.goal / span), (V, 0, 0 * span), (V, -1, 0 * span)):
        opti.subject_to(X[:, column] == value)

    node, n_z = node_function(mechanism), len(mechanism.dependent)
    in_z, row_units = ca.MX(0, len(times) - 1), np.full(mechanism.n_q, full.max())
    if n_z:
        one, nothing = np.ones(n_z), np.tile([-np.inf, np.inf], (3 * n_z, 1))
        units = np.concatenate([one, one / unit_s, one / unit_s**2, one * full.max() / mechanism.extent_m])
        start = _dependent_start(mechanism, node, poses[1:], v[1:], a[1:], u[1:])
        _, in_z = unknowns(start, units, np.vstack([limits.position[mechanism.dependent], nothing]))
        row_units = np.concatenate([one, one / unit_s, one / unit_s**2, row_units])
    rows, dets = node.map(len(times) - 1)(in_s[:, 1:], in_v[:, 1:], in_a, in_u, in_z)
    opti.subject_to(ca.diag(1 / row_units) @ rows == 0)
    if n_z:
        ratios = ca.diag(1 / mechanism.dynamics.block_singularity(poses[0])) @ dets
        opti.subject_to(ca.vec(ratios) >= _REGULAR)

    _, _, weights = ca.collocation_coeff(list(points))
    squares = ca.sum1((ca.diag(1 / full) @ in_u) ** 2 * full**2).T
    effort = T / INTERVALS * ca.dot(squares, ca.DM(np.tile(np.array(weights).ravel(), INTERVALS)))
    weight = problem.objective.weights
    objective = weight.get("time", 0.0) * T + weight.get("effort", 0.0) * effort
    size = float(full @ full) * unit_s  # of the effort
    if "time" in weight:
        opti.minimize((objective + (0.0 if "effort" in weight else _TIE * unit_s / size * effort)) / unit_s)
    else:
        opti.minimize(effort / size)
    opti.solver("ipopt", _SOLVER)
    return ManyPeer(opti, T, objective, in_u)


def _collocate(opti: ca.Opti, states: ca.MX, steps: ca.MX, unit: np.ndarray) -> None:
    """Impose that scaled states (n, n_nodes + 1) have the slopes `steps` (n, n_nodes), in SI a share of the interval."""
    D, _, _ = ca.collocation_coeff(ca.collocation_points(DEGREE, "radau"))
    at = [states[:, k::DEGREE][:, :INTERVALS] for k in range(DEGREE + 1)]
    for k in range(DEGREE):
        slope = sum(D[i, k] * at[i] for i in range(DEGREE + 1))
        opti.subject_to(slope == ca.diag(1 / unit) @ steps[:, k::DEGREE])


def _dependent_start(mechanism: Mechanism, node: ca.Function, poses, v, a, u) -> np.ndarray:
    """Return dependent joints, rates, accelerations and multipliers (n, 4 n_z) that suit a motion's samples best."""
    n_z, found = len(mechanism.dependent), []
    linear = np.eye(4 * n_z)[2 * n_z :]
    for pose, *others in zip(poses, v, a, u, strict=True):
        rates = np.array(mechanism.dynamics.velocity_map(pose)) @ others[0]
        z = np.concatenate([pose[mechanism.dependent], rates[mechanism.dependent], np.zeros(2 * n_z)])
        at = [np.array(node(pose[mechanism.independent], *others, z + step)[0]).ravel() for step in (0 * z, *linear)]
        z[2 * n_z :] = -np.linalg.lstsq((np.array(at[1:]) - at[0]).T, at[0], rcond=None)[0]
        found.append(z)
    return np.array(found)


def main(path: str) -> int:
    """Plan a problem file by the peer and print its answer as JSON; the exit code is 1 if IPOPT finds none."""
    peer = build_many_peer(load_problem(path))
    try:
        solution = peer.opti.solve()
    except RuntimeError:
        print(json.dumps({"status": peer.opti.stats()["return_status"], "objective": None}))
        return 1
    iterations = int(solution.stats()["iter_count"])
    print(json.dumps({"status": "solved", "objective": float(solution.value(peer.objective)), "iterations": iterations}))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
