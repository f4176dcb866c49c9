"""A mechanism as C99: closure, transmission, dynamics and derivatives, without memory allocation, in double and float."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import advance_all
from linkplan.models.reduction.elimination import solve_positive
from linkplan.models.tree.joints import unit_steps
from linkplan.studies.handover.export.c_text import (
    MATH,
    NO_LIMIT,
    CFunction,
    block_comment,
    declared_array,
    function_of,
    header_of,
    helpers,
    identifier,
    limit_macros,
    tests_text,
)

# Most Newton steps of a call of `close`. A stride of two degrees needs three; from home to the end of a range needs about
# 30.
MAX_NEWTON_STEPS = 200
# A function that a controller rarely needs and that is longer than all others together.
DERIVATIVES = "inverse_dynamics_derivatives"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ModelCode:
    """The C functions of a mechanism: those of its interface, and two that the Newton iterations of `close` call."""

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
    slopes = ca.jtimes(effort, q, gamma), ca.jacobian(effort, v)
    step, _, determinants = dynamics.closure_step(q)
    phi = dynamics.closure(q)
    size = ca.sum1(ca.fabs(phi)) if phi.numel() else ca.SX(0)  # a sum and not the largest, because C's fmax ignores NaN
    inner = [
        function_of(
            f"{prefix}_closure_step",
            "Newton's step in the dependent joints, and the determinants of the blocks of J_z",
            [("q", q)],
            [("step", step), ("det", determinants)],
        ),
        function_of(f"{prefix}_closure_gap", "sum of the closure equations' residuals", [("q", q)], [("gap", size)]),
    ]
    about = {
        "velocity_map": "Gamma (N_Q x N_S): rates of all joints = Gamma v",
        "transmission": "G (N_U x N_S): actuator velocity = G v, effort on the coordinates = G^T u",
        "reduced_inertia": "M (N_S x N_S), and inertia times acceleration = M a",
        "bias": "effort at zero acceleration: gravity, Coriolis, springs, dampers, friction",
        "inverse_dynamics": "effort = M a + bias, that the actuators must put on the coordinates: G^T u = effort",
        DERIVATIVES: "its derivatives (N_S x N_S) by s, with the loops closed, and by v; that by a is M",
        "acceleration": "a = M^-1 (G^T u - bias)",
    }
    parts = {
        "velocity_map": ([("q", q)], [("gamma", gamma)]),
        "transmission": ([("q", q)], [("ratio", ratio)]),
        "reduced_inertia": ([("q", q)], [("inertia", inertia)]),
        "bias": ([("q", q), ("v", v)], [("effort", dynamics.inverse_dynamics(q, v, still))]),
        "inverse_dynamics": ([("q", q), ("v", v), ("a", a)], [("effort", effort)]),
        DERIVATIVES: ([("q", q), ("v", v), ("a", a)], [("effort_by_s", slopes[0]), ("effort_by_v", slopes[1])]),
        "acceleration": ([("q", q), ("v", v), ("u", u)], [("a", solve_positive(inertia, dynamics.driven(q, v, u)))]),
    }
    if mechanism.n_u == 0:
        del parts["transmission"], parts["acceleration"]
    if len(mechanism.dependent) == 0:
        inner = []
    interface = [function_of(f"{prefix}_{name}", about[name], *both) for name, both in parts.items()]
    return ModelCode(mechanism=mechanism, prefix=prefix, inner=tuple(inner), interface=tuple(interface))


def header_text(code: ModelCode, about: Sequence[str]) -> str:
    """Return the header: conventions, units, and the declaration of every function; `about` are additional lines."""
    mechanism, upper = code.mechanism, code.prefix.upper()
    joints = [f"  q[{k}] {joint.name} [{joint.si_units[0]}]" for k, joint in enumerate(mechanism.joints)]
    spinning = np.flatnonzero(np.isin(mechanism.independent, mechanism.passive_dofs)).tolist()
    spins = dict.fromkeys(spinning, ", spins freely: any constant works")
    joints += [
        f"  s[{k}] {joint.name} [{joint.si_units[0]}], effort [{joint.si_units[1]}]{spins.get(k, '')}"
        for k, joint in enumerate(mechanism.independent_joints)
    ]
    joints += [f"  u[{k}] {motor.name} [{motor.unit}]" for k, motor in enumerate(mechanism.actuators)]
    comment = [
        f"{mechanism.name}: the reduced dynamics of a closed chain.",
        "",
        "q: positions of all joints, s: of the independent ones, v = ds/dt, a = dv/dt, u: efforts of the actuators.",
        "Matrices are stored row by row. Arrays must not overlap. SI units. No memory is allocated and there is no state.",
        f"Numbers are double, or float where {upper}_FLOAT is defined (for this header and the source file).",
        f"{code.prefix}_{DERIVATIVES} is omitted if {upper}_WITHOUT_DERIVATIVES is defined.",
        "",
        *joints,
        "",
        *about,
    ]
    sizes = {"N_Q": mechanism.n_q, "N_S": mechanism.dof, "N_U": mechanism.n_u, "MAX_NEWTON_STEPS": MAX_NEWTON_STEPS}
    sizes |= {"NOT_FINITE": 1, "NOT_CLOSED": 2}
    lines = [f'#define {upper}_MODEL_HASH "{mechanism.fingerprint()}"']
    lines += [f"#define {upper}_{name} {value}" for name, value in sizes.items()]
    ranges = np.array([(joint.lower, joint.upper) for joint in mechanism.joints])
    actuators = mechanism.actuators
    lines += ["", f"/* The model's limits: Q of the joints, U of the actuators' efforts; {NO_LIMIT:g} means none. */"]
    lines += limit_macros(
        code.prefix, "Q", [j.name for j in mechanism.joints], ranges, [j.si_units[0] for j in mechanism.joints]
    )
    lines += limit_macros(code.prefix, "U", [a.name for a in actuators], mechanism.effort_limit, [a.unit for a in actuators])
    lines += ["", "/* a closed pose to start from */", f"extern const {code.real} {code.prefix}_home[{mechanism.n_q}];", ""]
    lines += [
        block_comment(
            [
                "Close the loops at independent positions s: q is the last closed pose on entry, the new one on return.",
                "One call is enough, also for a distant s: it follows the branch of q in steps that it chooses. A control",
                f"period takes three Newton steps, a call at most {MAX_NEWTON_STEPS}. Returns 0, or leaves q unchanged and",
                f"returns {upper}_NOT_FINITE if s or q is not finite, {upper}_NOT_CLOSED if the loops open on the way.",
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
    """Return a C program that compares every function with the test vector; its exit code is 1 if one differs."""
    states = random_states(code.mechanism, 16, seed=1)
    return tests_text(code.prefix, code.real, code.interface, code.mechanism.independent, states)


def random_states(mechanism: Mechanism, n: int, seed: int) -> dict[str, np.ndarray]:
    """Return n random states (n, ...): closed poses q around home, velocities v, accelerations a, efforts u."""
    random, home = np.random.default_rng(seed), mechanism.home[mechanism.independent]
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    ranges = np.array([(joint.lower, joint.upper) for joint in mechanism.independent_joints])
    poses = np.empty((0, mechanism.n_q))
    while len(poses) < n:  # within a fifth of a radian, drawn again if the loops open on the path from home
        s = home + 0.2 * unit * random.uniform(-1, 1, (n - len(poses), mechanism.dof))
        s = np.clip(s, np.minimum(ranges[:, 0], home), np.maximum(ranges[:, 1], home))
        found = advance_all(mechanism, np.tile(mechanism.home, (len(s), 1)), s)
        poses = np.concatenate([poses, found[np.isfinite(found[:, 0])]])
    limit = np.abs(mechanism.effort_limit).max(axis=1)
    effort = np.where(np.isfinite(limit), limit, 1.0)
    return {
        "q": poses,
        "v": 2.0 * unit * random.normal(size=(n, mechanism.dof)),
        "a": 20.0 * unit * random.normal(size=(n, mechanism.dof)),
        "u": effort * random.uniform(-1, 1, (n, mechanism.n_u)),
    }


def _close_prototype(code: ModelCode) -> str:
    return f"int {code.prefix}_close(const {code.real} s[{code.mechanism.dof}], {code.real} q[{code.mechanism.n_q}])"


def _close_text(code: ModelCode) -> str:
    """Return the C function that closes the loops: a continuation in strides, each closed by Newton's method.

    A stride is accepted under three conditions. Its first Newton step is at most half a radian or metre, each further step
    is at most a quarter of the previous one (Deuflhard, Newton Methods for Nonlinear Problems, 2011, 5.1.3), and no
    determinant of a block of J_z changes its sign, so the branch is the same. Otherwise the stride is halved. Newton's
    method ends at a step below the square root of the precision; the remaining error is due to rounding.
    """
    mechanism, prefix, real, upper = code.mechanism, code.prefix, code.real, code.prefix.upper()
    n_s, n_q = mechanism.dof, mechanism.n_q
    finite = f"""  for (i = 0; i < {n_s}; ++i) if (!(s[i] - s[i] == 0)) return {upper}_NOT_FINITE;
  for (i = 0; i < {n_q}; ++i) if (!(q[i] - q[i] == 0)) return {upper}_NOT_FINITE;"""
    begin = "\n".join([_close_prototype(code), "{", "  int i;" if not code.inner else ""])
    given = "\n".join(f"  q[{int(i)}] = s[{k}];" for k, i in enumerate(mechanism.independent))
    if not code.inner:
        return f"{begin}\n{finite}\n{given}\n  return 0;\n}}\n"
    n_z, n_d = (code.inner[0].function.numel_out(k) for k in (0, 1))
    columns = [
        f"  static const int {name}[{len(at)}] = {{{', '.join(map(str, at.tolist()))}}};"
        for name, at in (("independent", mechanism.independent), ("dependent", mechanism.dependent))
    ]
    gap = 1e-6 * max(1.0, mechanism.extent_m)
    return f"""{_close_prototype(code)}
{{
{chr(10).join(columns)}
  const {real} small = sizeof({real}) == sizeof(float) ? ({real})3e-4 : ({real})1e-8;
  const {real} closed = sizeof({real}) == sizeof(float) ? ({real}){10 * gap!r} : ({real}){gap!r};
  {real} from[{n_q}], slope[{n_z}] = {{0}}, trial[{n_q}], step[{n_z}], det[{n_d}], sign[{n_d}];
  {real} gap[1], share = 0, stride = 1;
  int i, left = {upper}_MAX_NEWTON_STEPS;
{finite}
  for (i = 0; i < {n_q}; ++i) from[i] = q[i];
  {prefix}_closure_step(from, step, sign);
  while (share < 1) {{
    const {real} next = share + stride < 1 ? share + stride : 1;
    {real} before = 0, size;
    int arrived = 0, k;
    for (i = 0; i < {n_q}; ++i) trial[i] = from[i];
    for (i = 0; i < {n_s}; ++i) {{
      const int at = independent[i];
      trial[at] = next < 1 ? q[at] + next * (s[i] - q[at]) : s[i];
    }}
    for (i = 0; i < {n_z}; ++i) trial[dependent[i]] += (next - share) * slope[i];
    for (k = 0; !arrived; ++k) {{
      int regular = 1;
      if (left-- == 0) return {upper}_NOT_CLOSED;
      {prefix}_closure_step(trial, step, det);
      size = 0;
      for (i = 0; i < {n_z}; ++i) size += MATH(fabs)(step[i]); /* a step that is no number makes it none */
      for (i = 0; i < {n_d}; ++i) regular = regular && det[i] * sign[i] > 0;
      if (!(regular && size <= (k == 0 ? ({real})0.5 : ({real})0.25 * before + small))) break;
      for (i = 0; i < {n_z}; ++i) trial[dependent[i]] += step[i];
      arrived = size < small;
      before = size;
    }}
    if (arrived) {{
      for (i = 0; i < {n_z}; ++i) slope[i] = (trial[dependent[i]] - from[dependent[i]]) / (next - share);
      for (i = 0; i < {n_q}; ++i) from[i] = trial[i];
      share = next;
      stride *= 2;
    }} else {{
      stride *= ({real})0.5;
    }}
  }}
  {prefix}_closure_gap(from, gap);
  if (!(gap[0] <= closed)) return {upper}_NOT_CLOSED;
  for (i = 0; i < {n_q}; ++i) q[i] = from[i];
  return 0;
}}
"""
