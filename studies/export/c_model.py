"""A mechanism as C99: closure, transmission, dynamics and derivatives, without memory allocation, in double and float."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import continue_to
from linkplan.models.tree.joints import unit_steps
from linkplan.studies.export.c_source import CFunction, function_of, helpers, identifier
from linkplan.studies.export.c_text import MATH, block_comment, declared_array, header_of, tests_text

# Newton steps of a closure from the last pose: two leave 1e-9 after a stride of two degrees, three leave rounding.
NEWTON_STEPS = 3
# The function that a controller rarely needs, and that is longer than all others together.
DERIVATIVES = "inverse_dynamics_derivatives"
# States in the test vector.
_VECTOR_LENGTH = 16


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ModelCode:
    """The C functions of a mechanism: those of its interface, and two behind `close` that its loops of Newton call."""

    mechanism: Mechanism
    prefix: str
    inner: tuple[CFunction, ...]
    interface: tuple[CFunction, ...]

    @property
    def real(self) -> str:
        """The name of the type of all numbers."""
        return f"{self.prefix}_real"

    @property
    def functions(self) -> tuple[CFunction, ...]:
        """All generated functions."""
        return (*self.inner, *self.interface)


def model_code(mechanism: Mechanism) -> ModelCode:
    """Return the C functions of a mechanism."""
    prefix, dynamics = identifier(mechanism.name), mechanism.dynamics
    q, v, a, u = (
        ca.SX.sym(name, n)
        for name, n in (("q", mechanism.n_q), ("v", mechanism.dof), ("a", mechanism.dof), ("u", mechanism.n_u))
    )
    gamma, still = dynamics.velocity_map(q), ca.SX.zeros(mechanism.dof)
    ratio, inertia = dynamics.effort_map(q).T, dynamics.reduced_inertia(q)
    effort = dynamics.inverse_dynamics(q, v, a)
    slopes = ca.cse([ca.jtimes(effort, q, gamma), ca.jacobian(effort, v)])  # a third of the operations is common
    phi = dynamics.closure(q)
    size = ca.mmax(ca.fabs(phi)) if phi.numel() else ca.SX(0)
    inner = [
        function_of(
            f"{prefix}_closure_step",
            "Newton's step in the dependent joints",
            [("q", q)],
            [("step", dynamics.closure_step(q)[1])],
        ),
        function_of(f"{prefix}_closure_gap", "largest residual of the closure equations", [("q", q)], [("gap", size)]),
    ]
    about = {
        "velocity_map": "Gamma (N_Q x N_S): rates of all joints = Gamma v",
        "transmission": "G (N_U x N_S): actuator velocity = G v, effort on the coordinates = G^T u",
        "reduced_inertia": "M (N_S x N_S), and inertia times acceleration = M a",
        "bias": "effort at zero acceleration: gravity, Coriolis, springs, dampers, friction",
        "inverse_dynamics": "effort = M a + bias, that the actuators must put on the coordinates: G^T u = effort",
        DERIVATIVES: "its derivatives (N_S x N_S) by s, the loops kept closed, and by v; by a it is M",
        "acceleration": "a = M^-1 (G^T u - bias)",
    }
    parts = {
        "velocity_map": ([("q", q)], [("gamma", gamma)]),
        "transmission": ([("q", q)], [("ratio", ratio)]),
        "reduced_inertia": ([("q", q)], [("inertia", inertia)]),
        "bias": ([("q", q), ("v", v)], [("effort", dynamics.inverse_dynamics(q, v, still))]),
        "inverse_dynamics": ([("q", q), ("v", v), ("a", a)], [("effort", effort)]),
        DERIVATIVES: ([("q", q), ("v", v), ("a", a)], [("effort_by_s", slopes[0]), ("effort_by_v", slopes[1])]),
        "acceleration": ([("q", q), ("v", v), ("u", u)], [("a", dynamics.acceleration(q, v, u))]),
    }
    if mechanism.n_u == 0:
        del parts["transmission"], parts["acceleration"]
    if len(mechanism.dependent) == 0:
        inner = []
    interface = [function_of(f"{prefix}_{name}", about[name], *both) for name, both in parts.items()]
    return ModelCode(mechanism=mechanism, prefix=prefix, inner=tuple(inner), interface=tuple(interface))


def header_text(code: ModelCode, about: Sequence[str]) -> str:
    """Return the header: conventions, units, and the declaration of every function; `about` are further lines."""
    mechanism, upper = code.mechanism, code.prefix.upper()
    joints = [f"  q[{k}] {joint.name} [{joint.si_units[0]}]" for k, joint in enumerate(mechanism.joints)]
    joints += [
        f"  s[{k}] {joint.name} [{joint.si_units[0]}], effort [{joint.si_units[1]}]{_passive(mechanism, k)}"
        for k, joint in enumerate(mechanism.independent_joints)
    ]
    joints += [f"  u[{k}] {motor.name} [{motor.unit}]" for k, motor in enumerate(mechanism.actuators)]
    comment = [
        f"{mechanism.name}: the reduced dynamics of a closed chain.",
        "",
        "q: positions of all joints, s: of the independent ones, v = ds/dt, a = dv/dt, u: efforts of the actuators.",
        "Matrices are stored row by row. Arrays must not overlap. SI units. Nothing is allocated, no state is kept.",
        f"Numbers are double, or float where {upper}_FLOAT is defined (for this header and the source file).",
        f"{code.prefix}_{DERIVATIVES} is left out where {upper}_WITHOUT_DERIVATIVES is defined.",
        "",
        *joints,
        "",
        *about,
    ]
    sizes = {"N_Q": mechanism.n_q, "N_S": mechanism.dof, "N_U": mechanism.n_u, "NEWTON_STEPS": NEWTON_STEPS}
    lines = [f"#define {upper}_{name} {value}" for name, value in sizes.items()]
    lines += ["", "/* a closed pose to start from */", f"extern const {code.real} {code.prefix}_home[{mechanism.n_q}];", ""]
    lines += [
        block_comment(
            [
                "Close the loops at independent positions s: q is the last closed pose on entry, the new one on return.",
                f"{NEWTON_STEPS} Newton steps are made, whatever comes. Returns the largest residual [m or rad]:",
                "above 1e-6 the pose is not closed (too far from the last one, or out of reach).",
            ]
        ),
        f"{_close_prototype(code)};",
        "",
    ]
    for function in code.interface:
        lines += [f"/* {function.about} */", f"{function.prototype(code.real)};", ""]
    return header_of(code.prefix, comment, lines)


def source_text(code: ModelCode) -> str:
    """Return the source file."""
    mechanism, real = code.mechanism, code.real
    bodies = [("static " if k < len(code.inner) else "") + one.definition(real) for k, one in enumerate(code.functions)]
    bodies = [
        f"#ifndef {code.prefix.upper()}_WITHOUT_DERIVATIVES\n{body}#endif\n" if one.name.endswith(DERIVATIVES) else body
        for body, one in zip(bodies, code.functions, strict=True)
    ]
    lines = [f'#include "{code.prefix}.h"', "", MATH.format(upper=code.prefix.upper())]
    lines += [declared_array(f"const {real} {code.prefix}_home", mechanism.home, real), ""]
    lines += [helpers("".join(bodies), real), *bodies[: len(code.inner)], _close_text(code), *bodies[len(code.inner) :]]
    return "\n".join(lines)


def test_text(code: ModelCode) -> str:
    """Return a C program that compares every function with the test vector; its exit code is 1 if one is off."""
    states = random_states(code.mechanism, _VECTOR_LENGTH, seed=1)
    return tests_text(code.prefix, code.real, code.interface, code.mechanism.independent, states)


def random_states(mechanism: Mechanism, n: int, seed: int) -> dict[str, np.ndarray]:
    """Return n random states (n, ...): closed poses q around home, velocities v, accelerations a, efforts u."""
    random, home = np.random.default_rng(seed), mechanism.home[mechanism.independent]
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    ranges = np.array([(joint.lower, joint.upper) for joint in mechanism.independent_joints])
    poses = np.empty((0, mechanism.n_q))
    while len(poses) < n:  # a walk inside a fifth of a radian, begun again at home where the loops open
        walk = home + 0.2 * unit * random.uniform(-1, 1, (n - len(poses), mechanism.dof))
        walk = np.clip(walk, np.minimum(ranges[:, 0], home), np.maximum(ranges[:, 1], home))
        found, arrived = continue_to(mechanism, mechanism.home, walk)
        poses = np.concatenate([poses, found[:arrived]])
    limit = np.abs(mechanism.effort_limit).max(axis=1)
    effort = np.where(np.isfinite(limit), limit, 1.0)
    return {
        "q": poses,
        "v": 2.0 * unit * random.normal(size=(n, mechanism.dof)),
        "a": 20.0 * unit * random.normal(size=(n, mechanism.dof)),
        "u": effort * random.uniform(-1, 1, (n, mechanism.n_u)),
    }


def _close_prototype(code: ModelCode) -> str:
    return f"{code.real} {code.prefix}_close(const {code.real} s[{code.mechanism.dof}], {code.real} q[{code.mechanism.n_q}])"


def _close_text(code: ModelCode) -> str:
    mechanism, prefix, real = code.mechanism, code.prefix, code.real
    given = [f"  q[{int(i)}] = s[{k}];" for k, i in enumerate(mechanism.independent)]
    if not code.inner:
        return "\n".join([_close_prototype(code), "{", *given, "  return 0;", "}", ""])
    moved = [f"    q[{int(i)}] += step[{k}];" for k, i in enumerate(mechanism.dependent)]
    lines = [_close_prototype(code), "{", f"  {real} step[{len(mechanism.dependent)}], gap[1];", "  int k;", *given]
    lines += [f"  for (k = 0; k < {NEWTON_STEPS}; ++k) {{", f"    {prefix}_closure_step(q, step);", *moved, "  }"]
    return "\n".join([*lines, f"  {prefix}_closure_gap(q, gap);", "  return gap[0];", "}", ""])


def _passive(mechanism: Mechanism, k: int) -> str:
    return ", spins freely: any constant will do" if mechanism.independent[k] in mechanism.passive_dofs else ""
