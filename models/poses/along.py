"""Quantities of a mechanism along a motion, sampled: poses q (n, n_q), velocities v and accelerations a (n, n_s)."""

import functools

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism


@functools.lru_cache(maxsize=256)
def mapped(function: ca.Function, n: int) -> ca.Function:
    """Return a function of n samples side by side. Motions on the same mesh ask for the same ones again and again."""
    return function.map(n)


def sampled(function: ca.Function, *arguments: np.ndarray) -> np.ndarray:
    """Return a function's first output over samples: arguments (n, k), result (n, rows, columns)."""
    n = len(arguments[0])
    stacked = mapped(function, n)(*[a.T for a in arguments]).full()
    return stacked.reshape(function.size1_out(0), n, function.size2_out(0)).transpose(1, 0, 2)


def joint_rates(mechanism: Mechanism, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return every joint's speed q' = Gamma v (n, n_q)."""
    return np.einsum("kqs,ks->kq", sampled(mechanism.dynamics.velocity_map, q), v)


def needed_effort(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least efforts (n, n_u) that produce a motion, and the generalised effort (n, n_s) that they miss.

    u = (Gamma^T B)^+ tau; what is missed is zero where there are enough actuators.
    """
    tau = sampled(mechanism.dynamics.inverse_dynamics, q, v, a)[:, :, 0]
    maps = sampled(mechanism.dynamics.effort_map, q)
    effort = np.einsum("kus,ks->ku", np.linalg.pinv(maps), tau)
    return effort, tau - np.einsum("ksu,ku->ks", maps, effort)
