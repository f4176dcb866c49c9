"""Transcriptions: the representation of a motion on one interval, as validated constants.

On an interval of width h, with tau in [0, 1] and collocation nodes c_1..c_m, the acceleration is the polynomial through
its values a_i at the nodes. Velocity and position are its exact integrals,

    v(tau) = v_0 + h sum_j a_j int_0^tau l_j,      s(tau) = s_0 + h tau v_0 + h^2 sum_j a_j int_0^tau int l_j,

so s' = v at every instant and not only at the nodes. This is the second-order-consistent form of Moreno-Martin, Ros &
Celaya, arXiv 2302.09056; first-order schemes applied to q'' = f let the interpolated velocity differ from the derivative
of the interpolated position. Radau nodes give order 2m-1. Lobatto's three nodes are those of Hermite-Simpson.

In the first-order form of a scheme, s' is the polynomial through the nodal velocities. This form is kept for comparison:
"trapezoid" and "hermite-simpson" are first-order, "trapezoid-consistent" and "hermite-simpson-consistent" second-order.

The effort is a polynomial given by its Bernstein coefficients. The curve stays in their convex hull (Farouki, CAGD 29,
2012), so coefficients within a limit keep the effort within it at every instant. The default degree is m-1.
"""

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from linkplan.models.errors import ProblemError, nearest
from linkplan.planner.transcription.bernstein import bernstein_integral, bernstein_matrix
from linkplan.planner.transcription.scheme_names import EFFORTS, LOBATTO, MAX_DEGREE, NAMES


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scheme:
    """A transcription's constants on the unit interval, for m nodes.

    `nodes` (m,) are the nodes. `velocity` (m, m) and `position` (m, m) integrate nodal accelerations once and twice up to
    each node, `velocity_end` and `position_end` (m,) up to 1. `weights` (m,) are quadrature weights. `effort_at`
    (m, n_effort) maps Bernstein coefficients to values at the nodes. `velocity_coefficients` (m + 1, m) and
    `position_coefficients` (m + 2, m; m + 1 in first-order form) map nodal accelerations to the Bernstein coefficients of
    v - v_0 and s - s_0 - h tau v_0, `acceleration_coefficients` (m, m) to those of the acceleration itself.
    """

    name: str
    nodes: np.ndarray
    velocity: np.ndarray
    position: np.ndarray
    velocity_end: np.ndarray
    position_end: np.ndarray
    weights: np.ndarray
    effort_at: np.ndarray
    velocity_coefficients: np.ndarray
    position_coefficients: np.ndarray
    acceleration_coefficients: np.ndarray

    def __post_init__(self) -> None:
        m = len(self.nodes)
        tolerance = 1e-10  # nine Radau nodes are so ill-conditioned that five of sixteen digits are lost
        ones = np.ones(m)
        checks = (
            np.all(np.diff(self.nodes) > 0) and self.nodes[0] >= 0 and self.nodes[-1] <= 1,
            np.allclose(self.velocity @ ones, self.nodes, atol=tolerance),
            m == 1 or np.allclose(self.position @ ones, self.nodes**2 / 2, atol=tolerance),
            abs(self.weights.sum() - 1) < tolerance,
            m == 1 or abs(self.position_end.sum() - 0.5) < tolerance,
            np.allclose(self.effort_at.sum(axis=1), 1, atol=tolerance),
            np.allclose(bernstein_matrix(m, self.nodes) @ self.velocity_coefficients, self.velocity, atol=tolerance),
            np.allclose(bernstein_matrix(m - 1, self.nodes) @ self.acceleration_coefficients, np.eye(m), atol=tolerance),
            np.allclose(self.velocity_coefficients[-1], self.velocity_end, atol=tolerance),
            np.allclose(self.velocity_coefficients[-1], self.weights, atol=tolerance),
            np.allclose(
                bernstein_matrix(len(self.position_coefficients) - 1, self.nodes) @ self.position_coefficients,
                self.position,
                atol=tolerance,
            ),
            np.allclose(self.position_coefficients[-1], self.position_end, atol=tolerance),
        )
        if not all(checks):
            raise ValueError(f"scheme '{self.name}' is inconsistent: {checks}")
        for field in self.__slots__:
            value = getattr(self, field)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def n_nodes(self) -> int:
        """The number m of collocation nodes in an interval."""
        return len(self.nodes)

    @property
    def open_ends(self) -> tuple[int, ...]:
        """The ends of an interval, 0 or 1, without a node: 0 for Radau, both for Gauss."""
        return (0,) * bool(self.nodes[0] > 0) + (1,) * bool(self.nodes[-1] < 1)

    @property
    def at_open_ends(self) -> np.ndarray:
        """The matrix (n_open, m) that maps nodal accelerations to the accelerations at the open ends."""
        ends = bernstein_matrix(self.n_nodes - 1, np.array(self.open_ends, dtype=float))
        return ends @ self.acceleration_coefficients


def scheme(name: str, effort: str = "polynomial") -> Scheme:
    """Return the transcription called `name`, with efforts "constant", "linear" or "polynomial" over an interval.

    Raises:
        ProblemError: for an unknown name.
    """
    if not isinstance(name, str) or name not in NAMES:
        raise ProblemError(
            f"unknown mesh.scheme '{name}'{nearest(str(name), NAMES)}; schemes are {', '.join(NAMES[:4])},"
            f" radau-1 to radau-{MAX_DEGREE} and gauss-1 to gauss-{MAX_DEGREE}"
        )
    if not isinstance(effort, str) or effort not in EFFORTS:
        raise ProblemError(
            f"unknown mesh.effort '{effort}'{nearest(str(effort), EFFORTS)}; efforts are {', '.join(EFFORTS)}"
        )
    return _scheme(name, effort)


@cache
def _scheme(name: str, effort: str) -> Scheme:
    family = name.removesuffix("-consistent")
    if family in LOBATTO:
        return _build(name, np.array(LOBATTO[family]), effort, consistent=name != family)
    family, degree = name.split("-")
    points = ca.collocation_points(int(degree), {"radau": "radau", "gauss": "legendre"}[family])
    return _build(name, np.array(points), effort, consistent=True)


def _build(name: str, nodes: np.ndarray, effort: str, *, consistent: bool) -> Scheme:
    m = len(nodes)
    to_acceleration = np.linalg.inv(bernstein_matrix(m - 1, nodes))
    to_velocity = bernstein_integral(m - 1) @ to_acceleration
    velocity = bernstein_matrix(m, nodes) @ to_velocity
    # In first-order form the position integrates the polynomial through the nodal velocities.
    to_position = bernstein_integral(m) @ to_velocity if consistent else to_velocity @ velocity
    return Scheme(
        name=name,
        nodes=nodes,
        velocity=velocity,
        position=bernstein_matrix(len(to_position) - 1, nodes) @ to_position,
        velocity_end=to_velocity[-1].copy(),
        position_end=to_position[-1].copy(),
        weights=to_velocity[-1].copy(),
        effort_at=bernstein_matrix(min(EFFORTS[effort], m - 1), nodes),
        velocity_coefficients=to_velocity,
        position_coefficients=to_position,
        acceleration_coefficients=to_acceleration,
    )
