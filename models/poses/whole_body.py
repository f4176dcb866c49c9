"""The centre of mass of all bodies as a function of the pose, and the coordinates along which the ground has no places."""

import functools

import casadi as ca
import numpy as np

from linkplan.models.kinematics import gravity_of
from linkplan.models.mechanism import Mechanism, parametric_tree
from linkplan.models.poses.along import sampled


@functools.lru_cache(maxsize=16)
def centre_of_mass(mechanism: Mechanism) -> ca.Function:
    """Return the function from the pose q (n_q,) to the place (3,) [m] of the centre of mass of all moving bodies."""
    tree, given = parametric_tree(mechanism)
    moving = [body for body in range(1, tree.model.nbody) if tree.model.body_weldid[body]]
    total, sum_of = ca.SX(0), ca.SX.zeros(3)
    for body in moving:
        mass = ca.SX(tree.model.body_mass[body])
        total += mass
        sum_of += mass * tree.frames[body].point(ca.SX(tree.model.body_ipos[body]))
    place = ca.Function("place", [tree.q, given], [ca.densify(sum_of / total)])
    q = ca.SX.sym("q", mechanism.n_q)
    values = np.append(mechanism.parameter_values, np.zeros(given.numel() - len(mechanism.parameters)))
    return ca.Function("centre_of_mass", [q], [place(q, ca.DM(values))])


@functools.lru_cache(maxsize=16)
def centre_velocity(mechanism: Mechanism) -> ca.Function:
    """Return the function from the pose and the rates of all joints, (n_q,) each, to the velocity (3,) of that centre."""
    q, rates = ca.SX.sym("q", mechanism.n_q), ca.SX.sym("rates", mechanism.n_q)
    place = centre_of_mass(mechanism)(q)
    return ca.Function("centre_velocity", [q, rates], [ca.densify(ca.jtimes(place, q, rates))])


def total_mass(mechanism: Mechanism) -> float:
    """Return the mass [kg] of all moving bodies."""
    model = mechanism.model
    return float(sum(model.body_mass[body] for body in range(1, model.nbody) if model.body_weldid[body]))


def unit_acceleration(mechanism: Mechanism) -> float:
    """Return a unit of accelerations [m/s2]: the size of gravity, or 1 without gravity."""
    return float(np.linalg.norm(gravity_of(mechanism.model))) or 1.0


def fall_acceleration(mechanism: Mechanism) -> float:
    """Return the acceleration with which bodies fall [m/s2]; zero if nothing pulls them down."""
    return max(0.0, -float(gravity_of(mechanism.model)[2]))


def ground_slides(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the coordinates that move the whole mechanism along level ground, so that every place is like the others.

    Moving such a coordinate alone moves every body by the same horizontal way, and changes no inertia, force or closure.
    """
    place, dynamics = centre_of_mass(mechanism), mechanism.dynamics
    home = mechanism.home
    still = np.zeros(mechanism.n_q)

    def look(q: np.ndarray) -> np.ndarray:
        parts = dynamics.mass_matrix(q), dynamics.closure(q), dynamics.passive(q, still), dynamics.bias(q, still)
        return np.concatenate([np.array(part).ravel() for part in parts])

    near = np.random.default_rng(0).uniform(-0.1, 0.1, (2, mechanism.n_q))
    found = []
    for k, joint in enumerate(mechanism.joints):
        if joint.kind == "hinge" or np.isfinite([joint.lower, joint.upper]).any():
            continue
        step = np.eye(mechanism.n_q)[k] * mechanism.extent_m
        same = all(np.allclose(look(home + d), look(home + d + step), rtol=1e-9, atol=1e-9) for d in near)
        ways = sampled(place, np.array([home, home + near[0], home + near[0] + step]))[:, :, 0]
        way = ways[2] - ways[1]
        if same and abs(way[2]) < 1e-9 * mechanism.extent_m and np.isclose(np.linalg.norm(way), mechanism.extent_m):
            found.append(k)
    return tuple(found)
