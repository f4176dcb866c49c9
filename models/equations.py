"""The equations of a closed chain as CasADi functions with named inputs and outputs, and their values as arrays.

    M_r(q) a + b_r(q, v) = Gamma^T B u,   q' = Gamma(q) v,   phi(q) = 0

The symbols are those of `models.reduction.reduced`: q are all joints, v and a belong to the independent joints.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.actuation.distribution import distribute
from linkplan.models.errors import AssemblyError, ModelError, ProblemError, choose
from linkplan.models.reduction.closing import STEP_RAD, Closing, continued
from linkplan.models.reduction.reduced import ReducedDynamics
from linkplan.models.tree.joints import Joint, unit_steps

_POSE, _VELOCITY, _ACCELERATION, _EFFORT = "pose_rad", "velocity_rad_s", "acceleration_rad_s2", "effort"
# The inputs and the output of every equation by name.
EQUATIONS = {
    "closure": ((_POSE,), "gap_m"),
    "velocity_map": ((_POSE,), "velocity_map"),
    "transmission": ((_POSE,), "transmission"),
    "mass_matrix": ((_POSE,), "mass_matrix"),
    "bias": ((_POSE, _VELOCITY), "generalised_effort"),
    "inverse_dynamics": ((_POSE, _VELOCITY, _ACCELERATION), "generalised_effort"),
    "forward_dynamics": ((_POSE, _VELOCITY, _EFFORT), "acceleration_rad_s2"),
    "closure_force": ((_POSE, _VELOCITY, _ACCELERATION, _EFFORT), "force_n"),
}


@functools.lru_cache(maxsize=256)
def equation(dynamics: ReducedDynamics, name: str) -> ca.Function:
    """Return one of `EQUATIONS` as a CasADi function, which takes numbers, SX or MX.

    Raises:
        ProblemError: for an unknown name.
    """
    inputs, output = EQUATIONS[choose("equation", name, EQUATIONS, ProblemError)]
    n_q, n_s = dynamics.velocity_map.size_out(0)
    sizes = {_POSE: n_q, _VELOCITY: n_s, _ACCELERATION: n_s, _EFFORT: dynamics.effort_map.size2_out(0)}
    symbols = [ca.SX.sym(key, sizes[key]) for key in inputs]
    if name == "bias":
        value = dynamics.inverse_dynamics(*symbols, ca.SX.zeros(n_s))
    else:
        own = {"transmission": "effort_map", "mass_matrix": "reduced_inertia", "forward_dynamics": "acceleration"}
        value = getattr(dynamics, own.get(name, name))(*symbols)
    return ca.Function(name, symbols, [ca.densify(value)], list(inputs), [output])


def values(function: ca.Function, *arrays: object) -> np.ndarray:
    """Return a function's values for arrays (..., k), which broadcast: (..., m) for a column, else (..., m, n).

    Raises:
        ProblemError: if an array's last axis has not as many entries as the input.
    """
    given = [np.asarray(array, dtype=float) for array in arrays]
    for k, array in enumerate(given):
        if array.ndim == 0 or array.shape[-1] != function.size1_in(k):
            raise ProblemError(
                f"{function.name()} takes {function.name_in(k)} of shape (..., {function.size1_in(k)}), got {array.shape}"
            )
    lead = np.broadcast_shapes(*(array.shape[:-1] for array in given))
    n = math.prod(lead)
    columns = [np.broadcast_to(array, (*lead, array.shape[-1])).reshape(n, array.shape[-1]).T for array in given]
    rows, width = function.size_out(0)
    shape = (*lead, rows) if width == 1 and function.name() not in ("mass_matrix", "transmission", "velocity_map") else None
    if n == 0:
        return np.zeros(shape or (*lead, rows, width))
    found = np.array(function.map(n)(*columns)).reshape(rows, n, width).transpose(1, 0, 2)
    return found.reshape(shape or (*lead, rows, width))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Equations:
    """The equations of a mechanism, made by `Mechanism.equations`.

    Arrays of poses q (..., n_q) have all joints in the order of `Mechanism.joints`. Velocities and accelerations (..., n_s)
    have the independent joints. Angles are in radians, slides in metres. Leading axes broadcast.

        knee = linkplan.load_mechanism("optimus-knee")
        pose = knee.equations.closed_pose(at_deg={"O": 20.0})
        knee.equations.inverse_dynamics(pose, [1.0], [0.0])     # generalised efforts (1,) [N.m]
        knee.equations.function("inverse_dynamics")             # the same as a CasADi function
    """

    dynamics: ReducedDynamics
    joints: tuple[Joint, ...]
    home: np.ndarray
    independent: np.ndarray
    extent_m: float  # the size of the moving bodies
    effort_limit: np.ndarray  # (n_u, 2) of the actuators

    def function(self, name: str) -> ca.Function:
        """Return an equation of the closed chain as a CasADi function: for numbers, SX and MX, and for C code (`generate`).

        Args:
            name: "closure", "velocity_map", "transmission", "mass_matrix", "bias", "inverse_dynamics", "forward_dynamics" or
                "closure_force"; the methods of these names describe them. Inputs and outputs have names with units: angles
                are in radians, slides in metres.

        Raises:
            ProblemError: for an unknown name.
        """
        return equation(self.dynamics, name)

    def closed_pose(self, *, at_rad: Mapping[str, float] | None = None, at_deg: Mapping[str, float] | None = None,
                    at_m: Mapping[str, float] | None = None) -> np.ndarray:  # fmt: skip
        """Return the closed pose (n_q,) [rad or m] with independent joints at given positions; the others stay at home.

        Args:
            at_rad: hinges' angles [rad] by joint name.
            at_deg: likewise [deg].
            at_m: slides' positions [m] by joint name.

        Raises:
            ModelError: for a joint that is not an independent joint.
            AssemblyError: if the loops do not close there.
        """
        goal = self.home[self.independent].copy()
        names = [self.joints[k].name for k in self.independent]
        for given, factor in ((at_rad, 1.0), (at_deg, np.pi / 180), (at_m, 1.0)):
            for name, value in (given or {}).items():
                goal[names.index(choose("independent joint", name, names, ModelError))] = factor * float(value)
        # On the branch of home along a straight path.
        rules = Closing(dynamics=self.dynamics, step_size=STEP_RAD * unit_steps(self.joints, self.extent_m))
        q = [self.home, *(pose for _, (pose,) in continued(rules, self.home[None], goal[None]))][-1]
        if np.any(q[self.independent] != goal) or not np.linalg.norm(np.array(self.dynamics.closure(q))) < 1e-8:
            raise AssemblyError(f"the kinematic loop opens on the way to {np.round(goal, 6).tolist()} rad or m")
        return q

    def closure(self, pose_rad: np.ndarray) -> np.ndarray:
        """Return the closure residuals phi (..., n_closure_rows) [m] of poses (..., n_q) [rad or m]; zero where closed."""
        return values(self.function("closure"), pose_rad)

    def velocity_map(self, pose_rad: np.ndarray) -> np.ndarray:
        """Return Gamma (..., n_q, n_s) of closed poses (..., n_q): q' = Gamma v, the rates of all joints."""
        return values(self.function("velocity_map"), pose_rad)

    def transmission(self, pose_rad: np.ndarray) -> np.ndarray:
        """Return Gamma^T B (..., n_s, n_u) of closed poses: generalised efforts on the independent joints per effort."""
        return values(self.function("transmission"), pose_rad)

    def mass_matrix(self, pose_rad: np.ndarray) -> np.ndarray:
        """Return the reduced mass matrix M_r (..., n_s, n_s) of closed poses [kg m2, kg, or kg m]."""
        return values(self.function("mass_matrix"), pose_rad)

    def bias(self, pose_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
        """Return b_r (..., n_s) [N.m or N]: the generalised efforts that velocities, weight, springs and friction need.

        Args:
            pose_rad: closed poses (..., n_q) [rad, or m of slides].
            velocity_rad_s: of the independent joints (..., n_s) [rad/s or m/s].
        """
        return values(self.function("bias"), pose_rad, velocity_rad_s)

    def inverse_dynamics(
        self, pose_rad: np.ndarray, velocity_rad_s: np.ndarray, acceleration_rad_s2: np.ndarray
    ) -> np.ndarray:
        """Return the generalised efforts M_r a + b_r (..., n_s) [N.m or N] that a motion of the closed chain needs.

        Args:
            pose_rad: closed poses (..., n_q) [rad, or m of slides].
            velocity_rad_s: of the independent joints (..., n_s) [rad/s or m/s].
            acceleration_rad_s2: of the independent joints (..., n_s) [rad/s2 or m/s2].
        """
        return values(self.function("inverse_dynamics"), pose_rad, velocity_rad_s, acceleration_rad_s2)

    def actuator_efforts(
        self, pose_rad: np.ndarray, velocity_rad_s: np.ndarray, acceleration_rad_s2: np.ndarray
    ) -> np.ndarray:
        """Return the actuators' efforts (..., n_u) [N.m or N] that a motion needs, as `inverse_dynamics`.

        With more actuators than freedoms they are those of least norm within the model's limits.
        """
        needed = self.inverse_dynamics(pose_rad, velocity_rad_s, acceleration_rad_s2)
        maps = np.broadcast_to(self.transmission(pose_rad), (*needed.shape, len(self.effort_limit)))
        found = distribute(needed.reshape(-1, needed.shape[-1]), maps.reshape(-1, *maps.shape[-2:]), self.effort_limit)
        return found.reshape(*needed.shape[:-1], -1)

    def forward_dynamics(self, pose_rad: np.ndarray, velocity_rad_s: np.ndarray, effort: np.ndarray) -> np.ndarray:
        """Return the accelerations (..., n_s) [rad/s2 or m/s2] under actuators' efforts (..., n_u) [N.m or N]."""
        return values(self.function("forward_dynamics"), pose_rad, velocity_rad_s, effort)

    def closure_force(
        self, pose_rad: np.ndarray, velocity_rad_s: np.ndarray, acceleration_rad_s2: np.ndarray, effort: np.ndarray
    ) -> np.ndarray:
        """Return the forces (..., n_closure_rows) [N] that keep the loops closed, on the rows of `closure`."""
        return values(self.function("closure_force"), pose_rad, velocity_rad_s, acceleration_rad_s2, effort)
